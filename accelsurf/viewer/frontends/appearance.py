"""Colours of the window's controls, and the page of keys."""

from __future__ import annotations

from typing import NamedTuple

from PySide6.QtGui import QColor, QPalette

from accelsurf.viewer.scene.colors import SURFACE


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
#: Of error messages, which also begin with a word that says so.
ALARM = {"dark": "#FF9A7A", "light": "#B03A00"}

_KEYS = (
    ("Space", "run, pause"),
    ("Right, Left", "one step, back one step"),
    ("Home", "restart with the settings in force"),
    ("Ctrl+Z", "undo the last change"),
    ("Ctrl+Shift+Z", "make it again"),
    ("Ctrl+S", "save labels, mesh, picture, run.toml"),
    ("V  S  I  X", "look, size, inside, outside"),
    ("B  P  G  K", "ball, points, grow, shrink"),
    ("[  ]", "smaller, larger ball and brush"),
    ("C", "colour by the next quantity"),
    ("O  L", "volume, slices in 3D"),
    ("R", "camera as at first"),
    ("T", "dark, light"),
    ("F1, H", "this page"),
    ("Ctrl+Q", "close"),
)
_MOUSE = (
    ("surface", "left turns, middle moves, wheel zooms"),
    ("slices", "drag moves the slices, wheel changes the slice"),
    ("size", "press in the object, drag outwards until it fits"),
    ("inside, outside", "click what is, or is not, in the object"),
    ("ball, points", "press (and drag) where the run starts"),
    ("grow, shrink", "drag over the surface or in a slice"),
)


def _rows(lines: tuple[tuple[str, str], ...]) -> str:
    return "".join(f"<tr><td><b>{a}</b>&nbsp;&nbsp;</td><td>{b}</td></tr>" for a, b in lines)


HELP = f"<h3>Keys</h3><table>{_rows(_KEYS)}</table><h3>Mouse</h3><table>{_rows(_MOUSE)}</table>"


def palette(theme: str) -> QPalette:
    """Return Qt's colours for a theme."""
    ui = CONTROL_COLORS[theme]
    made = QPalette()
    roles = QPalette.ColorRole
    for role, color in {
        roles.Window: ui.background, roles.Base: ui.field, roles.AlternateBase: ui.raised, roles.Button: ui.raised,
        roles.Text: ui.ink, roles.WindowText: ui.ink, roles.ButtonText: ui.ink, roles.ToolTipBase: ui.field,
        roles.ToolTipText: ui.ink, roles.Highlight: SURFACE, roles.HighlightedText: "#101010",
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
    QPushButton:hover {{ border-color: {SURFACE}; }}
    QPushButton:disabled {{ color: {ui.weak}; }}
    QPushButton:checked, QPushButton#play {{ background: {SURFACE}; color: #101010; border-color: {SURFACE}; }}
    QPushButton#play:disabled {{ background: {ui.raised}; color: {ui.weak}; }}
    QSlider::groove:horizontal {{ height: 4px; border-radius: 2px; background: {ui.lines}; }}
    QSlider::sub-page:horizontal {{ background: {SURFACE}; border-radius: 2px; }}
    QSlider::sub-page:horizontal:disabled {{ background: {ui.lines}; }}
    QSlider::handle:horizontal {{ width: 14px; height: 14px; margin: -5px 0; border-radius: 7px;
        background: {ui.ink}; }}
    QSlider::handle:horizontal:disabled {{ background: {ui.weak}; }}
    QCheckBox::indicator {{ width: 13px; height: 13px; border: 1px solid {ui.weak}; border-radius: 3px;
        background: {ui.field}; }}
    QCheckBox::indicator:checked {{ background: {SURFACE}; border-color: {SURFACE}; }}
    QLabel#help {{ background: {ui.field}; border: 1px solid {SURFACE}; border-radius: 8px; padding: 14px 22px; }}
    QLabel#message {{ color: {ui.weak}; }}
    QLabel#message[failed="true"] {{ color: {ALARM[theme]}; font-weight: bold; }}
    """
