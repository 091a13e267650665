"""The panel beside the scene: sliders and choices for what can be steered. Knows no session; emits what was asked."""

from __future__ import annotations

import math
from collections.abc import Sequence

from PySide6.QtCore import QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QButtonGroup,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from accelsurf.grid.geometry import Geometry
from accelsurf.settings.catalogue import help_of, sliders
from accelsurf.settings.energy_terms import examples
from accelsurf.settings.entry import Slider
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import COLORS

#: Positions of a slider; and how long after the last change its value is emitted, milliseconds.
TICKS, DELAY_MS = 1000, 250
#: In the list of objects: the one that is nearest to the ball's centre.
NEAREST = "nearest"
#: Tool -> (its key, what is written on it, what it does).
TOOLS = {
    "look": ("V", "Look", "Turn the surface; drag in a slice to move the slices"),
    "size": ("S", "Size", "Press in the object and drag outwards until the outline fits: a click and a size"),
    "inside": ("I", "Inside", "Click in a slice, or draw a stroke: this is in the object, and stays in it"),
    "outside": ("X", "Outside", "Click in a slice, or draw a stroke: this is not in the object, and stays out of it"),
    "ball": ("B", "Ball", "Press in a slice or on the surface and drag: a ball to start from"),
    "points": ("P", "Points", "Click in a slice: small balls to start from, one for each point"),
    "grow": ("G", "Grow", "Press and drag in a slice or on the surface: add what the brush covers"),
    "shrink": ("K", "Shrink", "Press and drag in a slice or on the surface: remove what the brush covers"),
}

#: Buttons of tools beside each other.
TOOLS_IN_ROW = 4


class Amount(QWidget):
    """A number on a slider and in a box; optionally words that may stand for it.

    Parameters
    ----------
    low, high : float
        Ends of the slider; in the box the number may be larger.
    words : sequence of str
        Words that may stand for a number.
    power : float
        Above 1 the slider is finer at its lower end.
    digits : int
        After the point.
    limit : float, optional
        Largest number that the box takes.
    """

    changed = Signal(object)

    def __init__(
        self, low: float, high: float, words: Sequence[str] = (), power: float = 1.0, digits: int = 3,
        limit: float = 1e6,
    ) -> None:
        super().__init__()
        self._low, self._high, self._power = low, high, power
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, TICKS)
        self.slider.setPageStep(TICKS // 10)
        self.slider.setMinimumWidth(70)
        self.box = QDoubleSpinBox()
        self.box.setDecimals(digits)
        self.box.setRange(low, limit)
        self.box.setSingleStep((high - low) / 20)
        self.box.setKeyboardTracking(False)
        self.box.setFixedWidth(74)
        self.word: QComboBox | None = None
        line = QHBoxLayout(self)
        line.setContentsMargins(0, 0, 0, 0)
        line.setSpacing(4)
        if words:
            self.word = QComboBox()
            self.word.addItems([*words, "value"])
            self.word.setFixedWidth(66)
            self.word.activated.connect(self._on_word)
            line.addWidget(self.word)
        line.addWidget(self.slider, 1)
        line.addWidget(self.box)
        self._delay = QTimer(self, singleShot=True, interval=DELAY_MS)
        self._delay.timeout.connect(self._emit)
        self.slider.valueChanged.connect(self._slid)
        self.slider.sliderReleased.connect(self._emit)
        self.box.valueChanged.connect(self._typed)

    @property
    def value(self) -> float | str:
        """The number, or the word that stands for it."""
        if self.word is not None and self.word.currentText() != "value":
            return self.word.currentText()
        return float(self.box.value())

    @property
    def is_being_moved(self) -> bool:
        """Whether the user is changing it now, so that it does not show the value in force."""
        return self.slider.isSliderDown() or self._delay.isActive() or self.box.hasFocus()

    def show_value(self, value: float | str) -> None:
        """Show the value in force, without emitting it."""
        blockers = [QSignalBlocker(part) for part in (self.slider, self.box, self.word) if part is not None]
        if isinstance(value, str) and self.word is not None:
            self.word.setCurrentText(value)
        else:
            if self.word is not None:
                self.word.setCurrentText("value")
            self.box.setValue(float(value))
            self.slider.setValue(self._tick(float(value)))
        self._enable()
        del blockers

    def _enable(self) -> None:
        numeric = self.word is None or self.word.currentText() == "value"
        self.slider.setEnabled(numeric)
        self.box.setEnabled(numeric)

    def _tick(self, value: float) -> int:
        share = min(max((value - self._low) / (self._high - self._low), 0.0), 1.0)
        return round(TICKS * share ** (1.0 / self._power))

    def _slid(self, tick: int) -> None:
        value = self._low + (self._high - self._low) * (tick / TICKS) ** self._power
        with QSignalBlocker(self.box):
            self.box.setValue(value)
        # A drag is one change, emitted at its end; keys and clicks beside the handle are emitted after a delay.
        if not self.slider.isSliderDown():
            self._delay.start()

    def _typed(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._tick(value))
        self._delay.start()

    def _on_word(self) -> None:
        self._enable()
        if self.word is not None and self.word.currentText() == "value" and self.box.value() <= 0:
            self.box.setValue(0.25 * self._high)
        self._emit()

    def _emit(self) -> None:
        self._delay.stop()
        self.changed.emit(self.value)


class Panel(QWidget):
    """All that can be steered. Each signal says what the user asked for."""

    setting = Signal(str, object)
    tool_wanted = Signal(str)
    color_wanted = Signal(str)
    volume_wanted = Signal(bool)
    planes_wanted = Signal(bool)
    theme_wanted = Signal(str)
    undo_wanted = Signal()
    redo_wanted = Signal()
    save_wanted = Signal()

    def __init__(self, geometry: Geometry) -> None:
        super().__init__()
        self.setFixedWidth(316)
        steps = geometry.steps
        extents = [e for e, n in zip(geometry.extent_mm, geometry.shape, strict=True) if n > 1]
        self._flat = geometry.slice_axis is not None
        column = QVBoxLayout(self)
        column.setContentsMargins(8, 6, 8, 6)
        column.setSpacing(6)
        self.choices = {"energy": _choice(examples()), "flow": _choice(tuple(FLOWS))}
        finest = min(steps)
        self.amounts = {key: _amount(slider, finest) for key, slider in sliders().items()}
        column.addWidget(self._settings())
        column.addWidget(self._tools(finest, min(extents or [finest])))
        column.addWidget(self._appearance())
        column.addStretch(1)
        line = QHBoxLayout()
        self.undo = QPushButton("Undo")
        self.undo.setToolTip("Undo the last change (Ctrl+Z)")
        self.redo = QPushButton("Redo")
        self.redo.setToolTip("Make the undone change again (Ctrl+Shift+Z)")
        self.save = QPushButton("Save")
        self.save.setToolTip("Labels, mesh, picture, report and run.toml (Ctrl+S)")
        for button, signal in (
            (self.undo, self.undo_wanted), (self.redo, self.redo_wanted), (self.save, self.save_wanted),
        ):
            button.clicked.connect(signal)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            line.addWidget(button)
        column.addLayout(line)

    def _settings(self) -> QGroupBox:
        group = QGroupBox("Run")
        form = QFormLayout(group)
        form.setSpacing(5)
        form.setContentsMargins(8, 4, 8, 6)
        for key, choice in self.choices.items():
            choice.activated.connect(lambda _, key=key, choice=choice: self.setting.emit(key, choice.currentText()))
            form.addRow(key.capitalize(), choice)
        for key, amount in self.amounts.items():
            amount.changed.connect(lambda value, key=key: self.setting.emit(key, value))
            amount.setToolTip(help_of(key))
            form.addRow(QLabel(sliders()[key].label))
            form.addRow(amount)
        return group

    def _tools(self, finest: float, smallest: float) -> QGroupBox:
        group = QGroupBox("Mouse")
        grid = QGridLayout(group)
        grid.setSpacing(4)
        grid.setContentsMargins(8, 4, 8, 6)
        self._buttons = QButtonGroup(self)
        self.tools: dict[str, QPushButton] = {}
        for place, (name, (key, text, tip)) in enumerate(TOOLS.items()):
            button = QPushButton(text)
            button.setCheckable(True)
            button.setToolTip(f"{tip} ({key})")
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            button.clicked.connect(lambda _, name=name: self.tool_wanted.emit(name))
            self._buttons.addButton(button)
            self.tools[name] = button
            grid.addWidget(button, place // TOOLS_IN_ROW, place % TOOLS_IN_ROW)
        self.tools["look"].setChecked(True)
        self.radius = Amount(0.5 * finest, max(0.4 * smallest, 4.0 * finest), power=2.0, digits=2)
        self.radius.show_value(max(0.06 * smallest, 2.0 * finest))
        grid.addWidget(QLabel("Radius of click, ball and brush (mm)"), 2, 0, 1, TOOLS_IN_ROW)
        grid.addWidget(self.radius, 3, 0, 1, TOOLS_IN_ROW)
        self.object = _choice((NEAREST,))
        self.object.setToolTip("Which object clicks, Grow and Shrink are for")
        self._object_label = QLabel("Object")
        grid.addWidget(self._object_label, 4, 0)
        grid.addWidget(self.object, 4, 1, 1, TOOLS_IN_ROW - 1)
        self.show_objects(())
        return group

    def show_objects(self, ids: Sequence[int]) -> None:
        """Offer these objects to choose from; none for a run of one without an id."""
        names = [NEAREST, *map(str, ids)]
        if [self.object.itemText(place) for place in range(self.object.count())] != names:
            self.object.clear()
            self.object.addItems(names)
        for part in (self._object_label, self.object):
            part.setVisible(bool(ids))

    @property
    def object_id(self) -> int | None:
        """Id of the object to be changed; None is the nearest."""
        return None if self.object.currentText() == NEAREST else int(self.object.currentText())

    def _appearance(self) -> QGroupBox:
        group = QGroupBox("Show")
        form = QFormLayout(group)
        form.setSpacing(5)
        form.setContentsMargins(8, 4, 8, 6)
        self.color = _choice(COLORS)
        self.color.activated.connect(lambda: self.color_wanted.emit(self.color.currentText()))
        self.theme = _choice(("dark", "light"))
        self.theme.activated.connect(lambda: self.theme_wanted.emit(self.theme.currentText()))
        self.volume, self.planes = QCheckBox("Volume"), QCheckBox("Slices in 3D")
        for box, signal in ((self.volume, self.volume_wanted), (self.planes, self.planes_wanted)):
            box.toggled.connect(signal)
            box.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            box.setEnabled(not self._flat)
        self.color.setEnabled(not self._flat)
        form.addRow("Colour by", self.color)
        boxes = QHBoxLayout()
        boxes.addWidget(self.volume)
        boxes.addWidget(self.planes)
        form.addRow(boxes)
        form.addRow("Theme", self.theme)
        return group

    # -- settings in force --------------------------------------------------------------------------------

    def show_settings(self, settings: RunConfig, undoable: int, redoable: int) -> None:
        """Show the settings in force, except where the user is changing one."""
        for key, choice in self.choices.items():
            if not choice.view().isVisible():
                if choice.findText(getattr(settings, key)) < 0:
                    # The run's energy may be an expression that is not in the list.
                    choice.addItem(getattr(settings, key))
                choice.setCurrentText(getattr(settings, key))
        for key, amount in self.amounts.items():
            if not amount.is_being_moved:
                amount.show_value(getattr(settings, key))
            amount.setVisible(True)
            amount.setEnabled(settings.matters(key))
        self.undo.setEnabled(undoable > 0)
        self.redo.setEnabled(redoable > 0)

    def scale_radius(self, factor: float) -> None:
        """Multiply the radius of ball and brush."""
        value = float(self.radius.value) * factor
        self.radius.show_value(min(max(value, self.radius.box.minimum()), 1e5) if math.isfinite(value) else 1.0)


def _amount(slider: Slider, finest: float) -> Amount:
    """The widget of a setting, in an image whose smallest spacing is ``finest`` mm."""
    unit = finest**slider.voxel_power
    return Amount(slider.low * unit, slider.high * unit, slider.words, slider.power, slider.digits, slider.limit)


def _choice(names: Sequence[str]) -> QComboBox:
    choice = QComboBox()
    choice.addItems(list(names))
    choice.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
    choice.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
    return choice
