"""The panel of the picture: colours, theme, what is drawn in 3D."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtWidgets import QFormLayout, QHBoxLayout

from accelsurf.viewer.frontends.panels.section import Section, choice, show_choice, show_switch, switch
from accelsurf.viewer.scene.colors import THEMES
from accelsurf.viewer.workplace.workplace import Workplace


class PicturePanel(Section):
    """How the scene is drawn."""

    def __init__(self, workplace: Workplace) -> None:
        super().__init__("Picture", workplace)
        form = QFormLayout(self.body)
        form.setSpacing(5)
        form.setContentsMargins(8, 2, 8, 6)
        self.color, self.theme = choice(label="colour"), choice(label="theme")
        self.color.activated.connect(lambda _: self.ask("color", self.color.currentText()))
        self.theme.activated.connect(lambda _: self.ask("theme", self.theme.currentText()))
        self.volume, self.planes = switch("Image in 3D"), switch("Slices in 3D")
        self.volume.toggled.connect(lambda on: self.ask("volume", on))
        self.planes.toggled.connect(lambda on: self.ask("planes", on))
        form.addRow("Colour by", self.color)
        boxes = QHBoxLayout()
        boxes.addWidget(self.volume)
        boxes.addWidget(self.planes)
        form.addRow(boxes)
        form.addRow("Theme", self.theme)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show how the scene is drawn."""
        show_choice(self.color, state["colors"], state["color"])
        show_choice(self.theme, tuple(THEMES), state["theme"])
        for box, key in ((self.volume, "volume"), (self.planes, "planes")):
            show_switch(box, state[key])
            box.setEnabled(not state["is_flat"])
        self.color.setEnabled(not state["is_flat"])
