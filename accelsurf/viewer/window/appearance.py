"""Colours of the window's controls, and the page of keys."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from string import Template
from typing import NamedTuple

from PySide6.QtGui import QColor, QPalette

from accelsurf.viewer.actions.tool import Key, help_rows
from accelsurf.viewer.scene.colors import ALARM, EDGE, ON_SURFACE, SURFACE


class ControlColors(NamedTuple):
    """Colours of controls: background, fields, raised parts, text, weak text, lines."""

    background: str
    field: str
    raised: str
    ink: str
    weak: str
    lines: str


CONTROL_COLORS = {
    "dark": ControlColors("#1D2128", "#14171C", "#2B313B", "#F2F2F2", "#8A93A0", "#3A424E"),
    "light": ControlColors("#F3F4F6", "#FFFFFF", "#FFFFFF", "#1A1A1A", "#70767E", "#C4C9D0"),
}


def page_of_help(keys: Mapping[str, Key]) -> str:
    """Return the actions of keys and mouse, as rich text."""
    of_window = [("F1  H", "this page"), ("Ctrl+Q", "close")]
    rows = [*help_rows(keys), *of_window]
    half = -(-len(rows) // 2)
    # The keys stay in one line; their actions may take two where the window is narrow.
    columns = (
        "".join(
            f"<tr><td style='white-space: pre'><b>{a}</b>  </td><td>{b}</td></tr>" for a, b in part
        )
        for part in (rows[:half], rows[half:])
    )
    cells = "".join(f"<td width='50%'><table>{column}</table></td>" for column in columns)
    return f"<table width='100%'><tr>{cells}</tr></table>"


def palette(theme: str) -> QPalette:
    """Return Qt's colours for a theme."""
    ui = CONTROL_COLORS[theme]
    made = QPalette()
    roles = QPalette.ColorRole
    for role, color in {
        roles.Window: ui.background,
        roles.Base: ui.field,
        roles.AlternateBase: ui.raised,
        roles.Button: ui.raised,
        roles.Text: ui.ink,
        roles.WindowText: ui.ink,
        roles.ButtonText: ui.ink,
        roles.ToolTipBase: ui.field,
        roles.ToolTipText: ui.ink,
        roles.Highlight: SURFACE,
        roles.HighlightedText: ON_SURFACE,
        roles.PlaceholderText: ui.weak,
    }.items():
        made.setColor(role, QColor(color))
    for role in (roles.Text, roles.WindowText, roles.ButtonText):
        made.setColor(QPalette.ColorGroup.Disabled, role, QColor(ui.weak))
    return made


def sheet(theme: str) -> str:
    """Return the style sheet of the window."""
    text = resources.files("accelsurf.viewer").joinpath("window.qss").read_text(encoding="utf-8")
    shared = {
        "surface": SURFACE,
        "on_surface": ON_SURFACE,
        "edge": EDGE[theme],
        "alarm": ALARM[theme],
    }
    return Template(text).substitute(shared, **CONTROL_COLORS[theme]._asdict())
