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
#: Steps that can be undone.
MAX_STEPS = 10
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


def answered(
    volume: accelsurf.Volume, target: Target, before: accelsurf.Result | None, press: Press
) -> accelsurf.Result:
    """Return the object after a press; ``before`` is None for the first one."""
    x, y, z = volume.geometry.index_to_world(press.place)
    clicks: dict[str, Any] = {press.side: f"ball:{x:.6g},{y:.6g},{z:.6g},{press.radius:.6g}"}
    if target.is_mended and press.size_mm3 is not None:
        raise accelsurf.UsageError(
            "a size is that of a new object; this one is mended", "click inside or outside"
        )
    if before is None and target.is_mended:
        return accelsurf.refine(volume, labels=target.labels, object=target.id, **clicks)
    if before is None and press.side == "outside":
        raise accelsurf.UsageError("nothing is inside yet", "press in the object first")
    if before is None or press.is_first:
        # Of the cells of a microscope a volume in mm3 has few digits left, or an exponent.
        size = None if press.size_mm3 is None else f"{press.size_mm3:.20f}mm3"
        return accelsurf.segment(volume, size=size, answer=press.answer, **clicks)
    return accelsurf.refine(before, object=target.id if before.has_ids else None, **clicks)


def answer_or_error(*given: Any) -> accelsurf.Result | str:
    """Return the result of `answered`, or the line of its error: napari 0.9 stumbles over errors of workers."""
    try:
        return answered(*given)
    except accelsurf.AccelsurfError as error:
        return _line(error)


def painted(target: Target, result: accelsurf.Result | None) -> NDArray[np.integer[Any]]:
    """Return the labels with an object; where others are they stay."""
    if result is None:
        return target.labels
    if target.is_mended:
        return result.labels
    return np.where((result.labels > 0) & (target.labels == 0), target.id, target.labels)


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
        #: Results so far, the first press, the object; presses that wait while another is answered.
        self._steps: list[accelsurf.Result] = []
        self._first: Press | None = None
        self._target: Target | None = None
        self._volume: accelsurf.Volume | None = None
        self._worker: Any = None
        self._waiting: list[Press] = []
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

    def _begun(self) -> Target:
        """Return the object of the next press, and the volume that it lies in."""
        if self._target is not None:
            return self._target
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
        self._volume, self._target = volume, Target(labels, id, bool((labels == id).any()))
        return self._target

    def _set_steps(self, steps: list[accelsurf.Result]) -> None:
        """Set the results so far, and show the last one; voxels painted by hand elsewhere stay."""
        before, self._steps = self._steps, steps
        self._describe()
        if self._target is not None:
            layer = self._viewer.layers[self._labels.currentText()]
            old, new = (
                painted(self._target, some[-1] if some else None) for some in (before, steps)
            )
            changed = (old != new).reshape(layer.data.shape)
            layer.data[changed] = new.reshape(layer.data.shape)[changed]
            layer.refresh()

    # -- presses -------------------------------------------------------------------------------------------

    def _let_move(self, press: str) -> None:
        """Let a drag move the image, or not."""
        self._viewer.scene.camera.mouse_pan = press == MOVE

    def _on_press(self, viewer: Viewer, event: Any) -> Iterator[None]:
        mode = self._press.currentText()
        if mode == MOVE or event.button != 1 or viewer.dims.ndisplay != 2:
            return
        try:
            self._begun()
        except accelsurf.AccelsurfError as error:
            self._said.setText(_line(error))
            return
        assert self._volume is not None
        layer = self._viewer.layers[self._image.currentText()]
        place = _zyx(layer, event.position)
        radius = self._radius.value() * min(self._volume.geometry.spacing)
        press = Press(
            "outside" if mode == OUTSIDE else "inside", place, radius, is_first=mode == SIZE
        )
        yield
        while event.type == "mouse_move":
            if mode == SIZE:
                self.ask(self._sized(press, _zyx(layer, event.position)))
            yield
        self.ask(self._sized(press, _zyx(layer, event.position)) if mode == SIZE else press)

    def _sized(self, press: Press, end: NDArray[np.float64]) -> Press:
        """Return a press with the volume of a ball, in an image of one slice of a disc, up to the end of a drag."""
        assert self._volume is not None
        spacing, axis = self._volume.geometry.spacing, self._volume.geometry.slice_axis
        far = float(np.linalg.norm((end - press.place) * spacing))
        if far < min(spacing):  # no drag
            return press
        volume = 4.0 / 3.0 * math.pi * far**3 if axis is None else math.pi * far**2 * spacing[axis]
        return press._replace(radius=min(press.radius, far / 2.0), size_mm3=volume)

    def ask(self, press: Press) -> None:
        """Have a press answered beside the window; presses of a drag that wait for it are out of date."""
        self._waiting = [*(other for other in self._waiting if not other.is_first), press]
        if self._worker is None:
            self._answer_next()

    def _answer_next(self) -> None:
        self._worker = None
        if not self._waiting:
            return
        press, *self._waiting = self._waiting
        target, before = self._begun(), self._steps[-1] if self._steps else None
        self._said.setText(
            "..." if press.size_mm3 is None else f"about {_volume_text(press.size_mm3)} ..."
        )
        connect = {
            "returned": lambda result: self._show(target, press, result),
            "finished": self._answer_next,
        }
        self._worker = create_worker(
            answer_or_error, self._volume, target, before, press, _connect=connect
        )

    def _show(self, target: Target, press: Press, result: accelsurf.Result | str) -> None:
        if target is not self._target:
            return  # another object was begun, or a press taken back meanwhile
        if isinstance(result, str):
            self._said.setText(result)
            return
        if not target.is_mended and (not self._steps or press.is_first):
            self._first = press
        is_next = bool(self._steps) and (target.is_mended or not press.is_first)
        self._set_steps([*self._steps, result][-MAX_STEPS:] if is_next else [result])

    # -- buttons -------------------------------------------------------------------------------------------

    def take_answer(self, number: int) -> None:
        """Take another answer to the first click."""
        if self._first is not None:
            self.ask(self._first._replace(answer=number, is_first=True))

    def undo(self) -> None:
        """Take the last press back."""
        self._waiting, self._target = (
            [],
            self._target and self._target._replace(),
        )  # the answer under way is late
        self._set_steps(self._steps[:-1])

    def begin_object(self) -> None:
        """Begin with the label that is selected: a new object, or one that is mended."""
        self._steps = []
        self._first = None
        self._waiting = []
        self._target = None
        self._describe()

    def next_object(self) -> None:
        """Begin a new object, with the next label that is free."""
        if self._labels.currentText() in self._viewer.layers:
            layer = self._viewer.layers[self._labels.currentText()]
            layer.selected_label = int(layer.data.max()) + 1
        self.begin_object()

    def show_doubtful(self) -> None:
        """Show the most doubtful place: its slice, and a diamond."""
        found = self._object()
        if self._volume is None or found is None or found.quality.next_click is None:
            return
        layer = self._viewer.layers[self._image.currentText()]
        place = self._volume.geometry.world_to_index(found.quality.next_click)[3 - layer.ndim :]
        if DOUBTFUL in self._viewer.layers:
            self._viewer.layers.remove(DOUBTFUL)
        shape = {"symbol": "diamond", "size": 4, "face_color": "yellow"}
        self._viewer.add_points([place], name=DOUBTFUL, **shape, **_grid_of(layer))
        self._viewer.dims.set_point(
            range(self._viewer.dims.ndim)[-layer.ndim :], layer.data_to_world(place)
        )
        self._viewer.layers.selection.select_only(self._viewer.layers[self._labels.currentText()])

    def _object(self) -> Any:
        """Return the object as it is now; None where there is none."""
        if not self._steps or self._target is None:
            return None
        return self._steps[-1].by_id[self._target.id if self._steps[-1].has_ids else 1]

    def _describe(self) -> None:
        """Tell volume and probability, and offer other answers to the first click."""
        found = self._object()
        answers = () if found is None or len(self._steps) > 1 else found.quality.answers
        for number, button in enumerate(self._answers, 1):
            match = [answer for answer in answers if answer.number == number]
            button.setVisible(len(answers) > 1 and bool(match))
            volumes = [answer.volume_mm3 for answer in match]
            button.setText(
                "".join(self._size(mm3) if mm3 else "all that is alike" for mm3 in volumes)
            )
        text = ""
        if found is not None:
            text = f"{self._size(found.volume_mm3)}, {found.quality.likely}"
            text += "".join(
                f"\n{warning.partition('; try')[0]}" for warning in found.quality.warnings
            )
        self._said.setText(text)

    def _size(self, volume_mm3: float) -> str:
        """Return a volume in words, in an image of one slice the area."""
        assert self._volume is not None
        geometry = self._volume.geometry
        axis = geometry.slice_axis
        if axis is None:
            return _volume_text(volume_mm3)
        area, unit = volume_mm3 / geometry.spacing[axis], geometry.unit
        return f"{area * {'mm': 1.0, 'um': 1e6, 'nm': 1e12}[unit]:.4g} {unit}2"


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
