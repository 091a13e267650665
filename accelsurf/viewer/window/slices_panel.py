"""The panels of slices and of the picture: grey values, layout, colours, theme."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QDoubleSpinBox, QFormLayout, QGridLayout, QLabel

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.slices import MAX_GREY
from accelsurf.viewer.scene.colors import THEMES
from accelsurf.viewer.window.section_panel import (
    ScrollGuard,
    Section,
    choice,
    framed,
    furnished,
    show_choice,
    show_switch,
)

#: Entry of the list of windows for level and width set by hand.
BY_HAND = "by hand"


class SlicesPanel(Section):
    """Grey values and layout."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Slices", actions)
        grid = framed(QGridLayout(self.body))
        self.window_word = choice(
            "grey values",
            toolTip="Values that are drawn black and white; in a slice: drag with the right button",
            activated=lambda _: self._named(),
        )
        self.level, self.width_ = self._number(-MAX_GREY), self._number(0.0)
        self.layout_ = self.choice("layout", "layout")
        self.chart = self.switch("Chart", "chart", "The energies at each step")
        tip = "Slices smooth between voxels, or each voxel as a rectangle"
        self.interpolate = self.switch("Smooth", "interpolate", tip)
        tip = "Slices straight by anatomy, or along the voxels of an oblique scan (2)"
        self.straight = self.switch("Straight", "straight", tip)
        self.whole = self.button("Whole", "The whole image in each tile (R)", "whole")
        grid.addWidget(QLabel("Grey values"), 0, 0)
        grid.addWidget(self.window_word, 0, 1, 1, 3)
        for column, (text, box) in enumerate({"Level": self.level, "Width": self.width_}.items()):
            grid.addWidget(QLabel(text), 1, 2 * column)
            grid.addWidget(box, 1, 2 * column + 1)
        grid.addWidget(QLabel("Layout"), 2, 0)
        grid.addWidget(self.layout_, 2, 1, 1, 3)
        grid.addWidget(self.chart, 3, 0)
        grid.addWidget(self.interpolate, 3, 1, 1, 2)
        grid.addWidget(self.whole, 3, 3)
        grid.addWidget(self.straight, 4, 0, 1, 2, Qt.AlignmentFlag.AlignLeft)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the grey values and the layout."""
        word = state["window_word"]
        show_choice(
            self.window_word, [*state["windows"], *([] if word else [BY_HAND])], word or BY_HAND
        )
        for number, key in ((self.level, "level"), (self.width_, "width")):
            if not number.hasFocus():
                with QSignalBlocker(number):
                    number.setDecimals(0 if state["width"] >= 50 else 4)
                    number.setSingleStep(max(state["width"] / 20, 1e-4))
                    number.setValue(state[key])
        show_choice(self.layout_, state["layouts"], state["layout"])
        for box, key in (
            (self.chart, "chart"),
            (self.interpolate, "interpolate"),
            (self.straight, "straight"),
        ):
            show_switch(box, state[key])
        self.straight.setEnabled(state["is_oblique"])

    def _named(self) -> None:
        if self.window_word.currentText() != BY_HAND:
            self.ask("window_named", self.window_word.currentText())

    def _number(self, low: float) -> QDoubleSpinBox:
        box = furnished(
            QDoubleSpinBox(),
            minimum=low,
            maximum=MAX_GREY,
            keyboardTracking=False,
            minimumWidth=70,
            valueChanged=lambda _: self.ask("window", self.level.value(), self.width_.value()),
        )
        ScrollGuard(box)
        return box


class PicturePanel(Section):
    """Look of the scene."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Picture", actions)
        form = framed(QFormLayout(self.body), 5)
        self.color, self.theme = self.choice("colour", "color"), self.choice("theme", "theme")
        self.planes = self.switch("Slices in 3D", "planes")
        form.addRow("Colour by", self.color)
        form.addRow(self.planes)
        form.addRow("Theme", self.theme)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show how the scene is drawn."""
        show_choice(self.color, state["colors"], state["color"])
        show_choice(self.theme, tuple(THEMES), state["theme"])
        show_switch(self.planes, state["planes"])
        self.planes.setEnabled(not state["is_flat"])
        self.color.setEnabled(not state["is_flat"])
