"""Colours of the window's controls, and the page of keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from PySide6.QtGui import QColor, QPalette

from accelsurf.viewer.scene.colors import ALARM, EDGE, ON_SURFACE, SURFACE
from accelsurf.viewer.workplace.tool import Key, help_rows


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
    """Return what keys and mouse do, as rich text."""
    of_window = [("F1  H", "this page"), ("Ctrl+Q", "close")]
    rows = [*help_rows(keys), *of_window]
    half = -(-len(rows) // 2)
    # The keys stay in one line; what they do may take two where the window is narrow.
    columns = ("".join(f"<tr><td style='white-space: pre'><b>{a}</b>  </td><td>{b}</td></tr>" for a, b in part)
               for part in (rows[:half], rows[half:]))
    cells = "".join(f"<td width='50%'><table>{column}</table></td>" for column in columns)
    return f"<table width='100%'><tr>{cells}</tr></table>"


def palette(theme: str) -> QPalette:
    """Return Qt's colours for a theme."""
    ui = CONTROL_COLORS[theme]
    made = QPalette()
    roles = QPalette.ColorRole
    for role, color in {
        roles.Window: ui.background, roles.Base: ui.field, roles.AlternateBase: ui.raised, roles.Button: ui.raised,
        roles.Text: ui.ink, roles.WindowText: ui.ink, roles.ButtonText: ui.ink, roles.ToolTipBase: ui.field,
        roles.ToolTipText: ui.ink, roles.Highlight: SURFACE, roles.HighlightedText: ON_SURFACE,
        roles.PlaceholderText: ui.weak,
    }.items():
        made.setColor(role, QColor(color))
    for role in (roles.Text, roles.WindowText, roles.ButtonText):
        made.setColor(QPalette.ColorGroup.Disabled, role, QColor(ui.weak))
    return made


def sheet(theme: str) -> str:
    """Return the style sheet of the window."""
    ui = CONTROL_COLORS[theme]
    return f"""
    QWidget {{ font-size: 13px; }}
    QGroupBox {{ border: 1px solid {ui.lines}; border-radius: 6px; margin-top: 14px; padding-top: 4px; }}
    QGroupBox::title {{ subcontrol-origin: margin; left: 8px; padding: 0 3px; color: {ui.weak}; }}
    QPushButton {{ background: {ui.raised}; border: 1px solid {ui.lines}; border-radius: 5px; padding: 4px 8px; }}
    QPushButton:hover {{ border-color: {EDGE[theme]}; }}
    QPushButton:disabled {{ color: {ui.weak}; }}
    QPushButton:checked, QPushButton#play {{ background: {SURFACE}; color: {ON_SURFACE}; border-color: {SURFACE}; }}
    QPushButton#play:disabled {{ background: {ui.raised}; color: {ui.weak}; }}
    QToolButton#section {{ border: none; color: {ui.weak}; font-weight: bold; padding: 3px 0; }}
    QToolButton#section:focus, QPushButton:focus {{ color: {EDGE[theme]}; }}
    QSlider::groove:horizontal {{ height: 4px; border-radius: 2px; background: {ui.lines}; }}
    QSlider::sub-page:horizontal {{ background: {SURFACE}; border-radius: 2px; }}
    QSlider::sub-page:horizontal:disabled {{ background: {ui.lines}; }}
    QSlider::handle:horizontal {{ width: 14px; height: 14px; margin: -5px 0; border-radius: 7px;
        background: {ui.ink}; }}
    QSlider::handle:horizontal:disabled {{ background: {ui.weak}; }}
    QCheckBox::indicator {{ width: 13px; height: 13px; border: 1px solid {ui.weak}; border-radius: 3px;
        background: {ui.field}; }}
    QCheckBox::indicator:checked {{ background: {SURFACE}; border-color: {SURFACE}; }}
    QLabel#help {{ background: {ui.field}; border: 1px solid {EDGE[theme]}; border-radius: 8px; padding: 14px 22px; }}
    QLabel#message {{ color: {ui.weak}; }}
    QLabel#title {{ font-size: 24px; font-weight: bold; }}
    QListWidget {{ background: {ui.field}; border: 1px solid {ui.lines}; border-radius: 6px; }}
    QListWidget::item {{ padding: 4px 6px; }}
    QListWidget::item:disabled {{ color: {ui.weak}; }}
    QListWidget:focus {{ border-color: {EDGE[theme]}; }}
    QLabel#message[failed="true"] {{ color: {ALARM[theme]}; font-weight: bold; }}
    """
