"""Widget of napari: clicks, a size by a drag, other answers, probability, the most doubtful place, and mending."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from napari.layers import Image, Labels
from napari.qt.threading import create_worker
from numpy.typing import NDArray
from qtpy.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout, QLabel, QPushButton, QWidget

import accelsurf

if TYPE_CHECKING:
    from napari import Viewer

#: Actions of a press in the image.
MOVE = "moves the image"
INSIDE = "clicks inside"
OUTSIDE = "clicks outside"
SIZE = "and a drag say the size"
DOUBTFUL = "most doubtful place"


class Press(NamedTuple):
    """A press in an image.

    Attributes
    ----------
    side : {"inside", "outside"}
    place : ndarray (3,)
        Index z, y, x.
    radius : float
        Of the ball that it stands for, mm.
    size_mm3 : float, optional
        About the volume of the object.
    answer : int, optional
        To the first click; 1 is the likeliest.
    is_first : bool, optional
        The object begins anew.
    """

    side: str
    place: NDArray[np.float64]
    radius: float
    size_mm3: float | None = None
    answer: int = 1
    is_first: bool = False


class Target(NamedTuple):
    """An object: the labels that it is added to, its id, and whether it is one of them, which is mended."""

    labels: NDArray[np.integer[Any]]
    id: int
    is_mended: bool


def begun(volume: accelsurf.Volume, target: Target) -> accelsurf.Interaction:
    """Return the interaction of an object before its first press."""
    object = accelsurf.Interaction(volume)
    if target.is_mended:
        object.start_from(target.labels)
    return object


def answer(
    volume: accelsurf.Volume, target: Target, object: accelsurf.Interaction, press: Press | None
) -> accelsurf.Interaction:
    """Return the interaction after a press, another one if the object begins anew; None takes the last press back.

    Raises
    ------
    UsageError, InputError
        When it cannot be made; the object stays.
    """
    if press is None:
        if object.count > target.is_mended:  # an object that is mended begins with a gesture
            object.undo()
        return object
    if target.is_mended and press.size_mm3 is not None:
        raise accelsurf.UsageError(
            "a size is that of a new object; this one is mended", "click inside or outside"
        )
    x, y, z = volume.geometry.index_to_world(press.place)
    clicks: dict[str, Any] = {press.side: f"ball:{x:.6g},{y:.6g},{z:.6g},{press.radius:.6g}"}
    if target.is_mended:
        object.add(object=target.id, **clicks)
    elif press.is_first:
        object = begun(volume, target)
        # Of the cells of a microscope a volume in mm3 has few digits left, or an exponent.
        size = None if press.size_mm3 is None else f"{press.size_mm3:.20f}mm3"
        object.segment(size=size, answer=press.answer, **clicks)
    else:
        object.add(**clicks)
    return object


def answer_or_error(*given: Any) -> accelsurf.Interaction | str:
    """Return the object of `answer`, or the line of its error: napari 0.9 stumbles over errors of workers."""
    try:
        return answer(*given)
    except accelsurf.AccelsurfError as error:
        return _line(error)


def painted(target: Target, object: accelsurf.Interaction) -> NDArray[np.integer[Any]]:
    """Return the labels with an object; where others are they stay."""
    labels = object.labels
    if target.is_mended:
        return labels
    return np.where((labels > 0) & (target.labels == 0), target.id, target.labels)


class ClickWidget(QWidget):
    """Segments an object of an image layer by clicks, into a labels layer of its own or one that is mended."""

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self._viewer = napari_viewer
        self._image, self._labels, self._press = QComboBox(), QComboBox(), QComboBox()
        self._press.addItems([MOVE, INSIDE, OUTSIDE, SIZE])
        self._radius = QDoubleSpinBox()
        self._radius.setRange(0.5, 100.0)
        self._radius.setValue(3.0)
        self._answers = [QPushButton() for _ in range(3)]
        self._undo, self._new, self._go = (
            QPushButton("Undo"),
            QPushButton("Next object"),
            QPushButton("Show doubtful"),
        )
        self._said = QLabel("Choose what a press does, and press in the object.")
        self._said.setWordWrap(True)
        layout = QFormLayout(self)
        rows = {
            "Image": self._image,
            "Labels": self._labels,
            "A press": self._press,
            "Ball (voxels)": self._radius,
        }
        for title, row in rows.items():
            layout.addRow(title, row)
        for button in (*self._answers, self._undo, self._new, self._go, self._said):
            layout.addRow(button)
        for number, button in enumerate(self._answers, 1):
            button.clicked.connect(lambda _=False, number=number: self.take_answer(number))
            button.hide()
        self._undo.clicked.connect(lambda: self.undo())
        self._new.clicked.connect(lambda: self.next_object())
        self._go.clicked.connect(lambda: self.show_doubtful())
        self._press.currentTextChanged.connect(self._let_move)
        for box in (self._image, self._labels):
            box.textActivated.connect(lambda: self.begin_object())
        #: The object, its result and labels as they are shown, its first press; presses that wait for their answer.
        self._object: accelsurf.Interaction | None = None
        self._result: accelsurf.Result | None = None
        self._target: Target | None = None
        self._shown: NDArray[np.integer[Any]] | None = None
        self._first: Press | None = None
        self._worker: Any = None
        self._waiting: list[Press | None] = []
        self._volume: accelsurf.Volume | None = None
        self.reset_choices()
        napari_viewer.mouse_drag_callbacks.append(self._on_press)

    # -- layers --------------------------------------------------------------------------------------------

    def reset_choices(self, event: Any = None) -> None:
        """Offer the layers that are there; napari calls it when they change."""
        for box, kind, more in ((self._image, Image, []), (self._labels, Labels, ["a new layer"])):
            names = more + [layer.name for layer in self._viewer.layers if isinstance(layer, kind)]
            before = box.currentText()
            box.clear()
            box.addItems(names)
            box.setCurrentText(before)
            if box.currentText() != before:  # the layer is gone
                self.begin_object()

    def _begun(self) -> accelsurf.Interaction:
        """Return the object of the next press."""
        if self._object is not None:
            return self._object
        name = self._image.currentText()
        if name not in self._viewer.layers:
            raise accelsurf.UsageError(
                "there is no image", "open one, or File > Open Sample > accelsurf"
            )
        image = self._viewer.layers[name]
        data = image.data[0] if image.multiscale else image.data
        if image.rgb or data.ndim not in (2, 3):
            raise accelsurf.UsageError(
                f"{name}: an image of grey values in two or three dimensions is needed"
            )
        scale = [
            abs(float(step)) * _mm(unit)
            for step, unit in zip(image.scale, image.units, strict=True)
        ]
        spacing = tuple(([min(scale)] if data.ndim == 2 else []) + scale)
        volume = accelsurf.Volume.from_array(np.asarray(data), (spacing[0], spacing[1], spacing[2]))
        if self._labels.currentText() not in self._viewer.layers:
            new = np.zeros(data.shape, np.uint16)
            layer = self._viewer.add_labels(new, name=f"{name} object", **_grid_of(image))
            self._labels.setCurrentText(layer.name)  # napari has called reset_choices
        layer = self._viewer.layers[self._labels.currentText()]
        if not isinstance(layer.data, np.ndarray) or layer.data.shape != data.shape:
            raise accelsurf.UsageError(
                f"{layer.name}: labels in memory on the grid of the image are needed"
            )
        labels, id = layer.data.reshape(volume.geometry.shape).copy(), int(layer.selected_label)
        if id < 1 or not np.can_cast(np.min_scalar_type(id), labels.dtype):
            raise accelsurf.UsageError(
                f"{layer.name}: {id} cannot be the label of an object", "select another label"
            )
        self._target = Target(labels, id, bool((labels == id).any()))
        self._volume, self._shown = volume, labels
        self._object = begun(volume, self._target)
        return self._object

    def _paint(self) -> None:
        """Show the object as it is now; voxels painted by hand elsewhere stay."""
        self._result = None if self._object is None else self._object.result
        self._describe()
        if self._object is None or self._target is None or self._shown is None:
            return
        layer = self._viewer.layers[self._labels.currentText()]
        new = painted(self._target, self._object)
        changed = (self._shown != new).reshape(layer.data.shape)
        layer.data[changed] = new.reshape(layer.data.shape)[changed]
        layer.refresh()
        self._shown = new

    # -- presses -------------------------------------------------------------------------------------------

    def _let_move(self, press: str) -> None:
        """Let a drag move the image, or not."""
        self._viewer.scene.camera.mouse_pan = press == MOVE

    def _on_press(self, viewer: Viewer, event: Any) -> Iterator[None]:
        mode = self._press.currentText()
        if mode == MOVE or event.button != 1 or viewer.dims.ndisplay != 2:
            return
        try:
            object = self._begun()
        except accelsurf.AccelsurfError as error:
            self._said.setText(_line(error))
            return
        layer = self._viewer.layers[self._image.currentText()]
        place = _zyx(layer, event.position)
        radius = self._radius.value() * min(object.geometry.spacing)
        side = "outside" if mode == OUTSIDE else "inside"
        press = Press(side, place, radius, is_first=mode == SIZE)
        yield
        while event.type == "mouse_move":
            if mode == SIZE:
                self.ask(_sized(press, _zyx(layer, event.position), object.geometry))
            yield
        end = _zyx(layer, event.position)
        self.ask(_sized(press, end, object.geometry) if mode == SIZE else press)

    def ask(self, press: Press | None) -> None:
        """Have a press answered beside the window; presses of a drag that wait for it are out of date."""
        self._waiting = [
            *(other for other in self._waiting if not (other and other.is_first)),
            press,
        ]
        if self._worker is None:
            self._answer_next()

    def _answer_next(self) -> None:
        self._worker = None
        if not self._waiting:
            return
        press, *self._waiting = self._waiting
        object = self._begun()
        size_mm3 = None if press is None else press.size_mm3
        self._said.setText("..." if size_mm3 is None else f"about {_volume_text(size_mm3)} ...")
        connect = {
            "returned": lambda found: self._show(object, press, found),
            "finished": self._answer_next,
        }
        self._worker = create_worker(
            answer_or_error, self._volume, self._target, object, press, _connect=connect
        )

    def _show(
        self, object: accelsurf.Interaction, press: Press | None, found: accelsurf.Interaction | str
    ) -> None:
        if object is not self._object:
            return  # another object was begun meanwhile
        if isinstance(found, str):
            self._said.setText(found)
            return
        if press is not None and (press.is_first or found.count == 1):
            self._first = press
        self._object = found
        self._paint()

    # -- buttons -------------------------------------------------------------------------------------------

    def take_answer(self, number: int) -> None:
        """Take another answer to the first click."""
        if self._first is not None:
            self.ask(self._first._replace(answer=number, is_first=True))

    def undo(self) -> None:
        """Take the last press back, also one that waits or is being answered."""
        if self._waiting:
            self._waiting.pop()
        elif self._object is not None:
            self.ask(None)

    def begin_object(self) -> None:
        """Begin with the label that is selected: a new object, or one that is mended."""
        self._object = self._result = self._target = self._shown = self._first = None
        self._waiting = []
        self._describe()

    def next_object(self) -> None:
        """Begin a new object, with the next label that is free."""
        if self._labels.currentText() in self._viewer.layers:
            layer = self._viewer.layers[self._labels.currentText()]
            layer.selected_label = int(layer.data.max()) + 1
        self.begin_object()

    def show_doubtful(self) -> None:
        """Show the most doubtful place: its slice, and a diamond."""
        found = self._found()
        if self._object is None or found is None or found.quality.next_click is None:
            return
        layer = self._viewer.layers[self._image.currentText()]
        place = self._object.geometry.world_to_index(found.quality.next_click)[3 - layer.ndim :]
        if DOUBTFUL in self._viewer.layers:
            self._viewer.layers.remove(DOUBTFUL)
        shape = {"symbol": "diamond", "size": 4, "face_color": "yellow"}
        self._viewer.add_points([place], name=DOUBTFUL, **shape, **_grid_of(layer))
        self._viewer.dims.set_point(
            range(self._viewer.dims.ndim)[-layer.ndim :], layer.data_to_world(place)
        )
        self._viewer.layers.selection.select_only(self._viewer.layers[self._labels.currentText()])

    def _found(self) -> Any:
        """Return the object of the result as it is now; None where there is none."""
        result = self._result
        if result is None or self._target is None:
            return None
        return result.by_id[self._target.id if result.has_ids else 1]

    def _describe(self) -> None:
        """Tell volume and probability, and offer other answers to the first click."""
        found, result = self._found(), self._result
        is_corrected = result is None or bool(result.config.refine)
        answers = () if found is None or is_corrected else found.quality.answers
        for number, button in enumerate(self._answers, 1):
            match = [answer for answer in answers if answer.number == number]
            button.setVisible(len(answers) > 1 and bool(match))
            volumes = [answer.volume_mm3 for answer in match]
            button.setText(
                "".join(self._size(mm3) if mm3 else "all that is alike" for mm3 in volumes)
            )
        text = "" if self._object is None else "Nothing is inside yet: press in the object."
        if found is not None:
            text = f"{self._size(found.volume_mm3)}, {found.quality.likely}"
            text += "".join(
                f"\n{warning.partition('; try')[0]}" for warning in found.quality.warnings
            )
        self._said.setText(text)

    def _size(self, volume_mm3: float) -> str:
        """Return a volume in words, in an image of one slice the area."""
        assert self._object is not None
        geometry = self._object.geometry
        axis = geometry.slice_axis
        if axis is None:
            return _volume_text(volume_mm3)
        area, unit = volume_mm3 / geometry.spacing[axis], geometry.unit
        return f"{area * {'mm': 1.0, 'um': 1e6, 'nm': 1e12}[unit]:.4g} {unit}2"


def _sized(press: Press, end: NDArray[np.float64], geometry: Any) -> Press:
    """Return a press with the volume of a ball, in an image of one slice of a disc, up to the end of a drag."""
    spacing, axis = geometry.spacing, geometry.slice_axis
    far = float(np.linalg.norm((end - press.place) * spacing))
    if far < min(spacing):  # no drag
        return press
    volume = 4.0 / 3.0 * math.pi * far**3 if axis is None else math.pi * far**2 * spacing[axis]
    return press._replace(radius=min(press.radius, far / 2.0), size_mm3=volume)


def _volume_text(mm3: float) -> str:
    """Return a volume in the unit that people use for its size."""
    if mm3 >= 1000.0:
        return f"{mm3 / 1000.0:.4g} ml"
    return f"{mm3:.4g} mm3" if mm3 >= 0.01 else f"{mm3 * 1e9:.4g} um3"


def _grid_of(layer: Image) -> dict[str, Any]:
    """Return where the voxels of a layer lie, as settings of another layer."""
    return {key: getattr(layer, key) for key in ("scale", "translate", "rotate", "affine", "units")}


def _zyx(layer: Image, position: Any) -> NDArray[np.float64]:
    """Return the index z, y, x in an image of a position in napari's world."""
    return np.array([0.0, *layer.world_to_data(position)][-3:])


def _mm(unit: Any) -> float:
    """Return a unit of length in mm; a pixel counts as one."""
    return float((1 * unit).to("mm").magnitude) if unit.is_compatible_with("mm") else 1.0


def _line(error: accelsurf.AccelsurfError) -> str:
    """Return an error and its hint as a line."""
    return f"{error} ({error.hint})" if error.hint else str(error)
