"""Interaction: objects of an image in memory, found and corrected gesture by gesture, each undone at will."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import (
    Box,
    Corner,
    bounding_box,
    box_at,
    enclosing,
    on_box,
    placed_at,
)
from accelsurf.grid.clicks import Click
from accelsurf.interact.finished import OnObjectStep, finished
from accelsurf.interact.refine import beginning_with
from accelsurf.interact.refiner import Change, Refiner
from accelsurf.io import ImageLike, array_of, as_volume
from accelsurf.run import Result, Run
from accelsurf.settings import budgets
from accelsurf.settings.corrections import Correction, corrections_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import read_clicks
from accelsurf.text.voxel_lists import voxels_text

#: A click: as a text of the settings ``inside`` and ``outside``, or as voxels.
ClickLike = str | Click


class _State(NamedTuple):
    """The objects before or after a gesture.

    Attributes
    ----------
    refiner : Refiner or None
        Which has the objects; None as long as nothing was clicked inside.
    outside : tuple of str
        Clicked outside before there was an object.
    """

    refiner: Refiner | None = None
    outside: tuple[str, ...] = ()


class _Gesture(NamedTuple):
    """A gesture that can be undone.

    Attributes
    ----------
    before : _State or None
        The objects before a gesture that began them; None of a correction, which `Refiner.undo` takes back.
    nbytes : int
        Memory of the clicks or labels that were given.
    changed : tuple of slice or None
        The box in which labels have changed.
    """

    before: _State | None
    nbytes: int
    changed: Box | None


class Interaction:
    """Objects of an image by a person's gestures; every client of accelsurf plays them here.

    The first click inside segments an object as `accelsurf.segment` does; a later one corrects it as
    `accelsurf.refine` does, at the cost of its neighbourhood. The same gestures give the same bytes in the command
    line, the window, the server and the plug-in. Each can be undone.

    Parameters
    ----------
    image : image
        As `accelsurf.segment` takes it; never modified. A 2D array is one slice.
    spacing : float, str or (hz, hy, hx), optional
        mm, for an array only; 1 by default.
    channels : sequence of image, optional
        Further ones, on the same grid.
    on_step : callable, optional
        Called with each `StepRecord` and the id of its object; a true return value ends the gesture's motion.
    **settings
        Of the run that the first click begins, as of `accelsurf.segment`.

    Attributes
    ----------
    geometry : Geometry
        The image's grid.

    Raises
    ------
    InputError
        When an image cannot be used; GeometryError when a channel lies on another grid.
    UsageError
        When a setting is unknown or out of bounds.

    Examples
    --------
    >>> import numpy as np
    >>> image = 100.0 * (((np.indices((24, 24, 24)) - 11.5) ** 2).sum(axis=0) < 8**2)
    >>> object = Interaction(image)
    >>> object.add(inside="ball:11.5,11.5,11.5,4")
    (slice(4, 20, None), slice(4, 20, None), slice(4, 20, None))
    >>> bool((object.labels == (image > 50)).all())
    True
    >>> object.undo() is not None, bool(object.labels.any())
    (True, False)
    """

    def __init__(
        self,
        image: ImageLike,
        *,
        spacing: float | str | tuple[float, float, float] | None = None,
        channels: Sequence[ImageLike] = (),
        on_step: OnObjectStep | None = None,
        **settings: Any,
    ) -> None:
        self._volume = as_volume(image, spacing)
        self.geometry = self._volume.geometry
        self._channels = tuple(
            self._volume.with_array(array_of(channel, self.geometry, "channel"))
            for channel in channels
        )
        self._config = RunConfig(**settings)
        self._on_step = on_step
        self._now, self._gestures = _State(), list[_Gesture]()

    @property
    def result(self) -> Result | None:
        """The objects as a result, whose settings repeat every gesture; None where there is no object."""
        return None if self._now.refiner is None else self._now.refiner.result()

    @property
    def labels(self) -> NDArray[np.integer[Any]]:
        """The objects (nz, ny, nx): 1 inside of one alone, else the ids of several; 0 elsewhere."""
        found = self.result
        return np.zeros(self.geometry.shape, np.uint8) if found is None else found.labels

    def labels_on(self, box: Box) -> NDArray[np.integer[Any]]:
        """Return the labels on a box of the grid."""
        refiner = self._now.refiner
        if refiner is None:
            return np.zeros([side.stop - side.start for side in box], np.uint8)
        if refiner.has_ids:
            return np.asarray(refiner.result().labels[box])
        (surface,) = refiner.surfaces
        domain = placed_at(box_at(surface.corner, surface.psi.shape), refiner.first)
        return (on_box(surface.psi, domain, box, 1.0) < 0).astype(np.uint8)

    @property
    def count(self) -> int:
        """Number of gestures that can be undone."""
        return len(self._gestures)

    # -- gestures ------------------------------------------------------------------------------------------

    def add(
        self,
        inside: ClickLike | Sequence[ClickLike] = (),
        outside: ClickLike | Sequence[ClickLike] = (),
        **correction: Any,
    ) -> Box | None:
        """Click voxels that are in an object, or not in it, as one gesture.

        Parameters
        ----------
        inside, outside : str or Click, or a sequence of them
            As of `accelsurf.refine`; voxels of a `Click` are on the image's grid. Clicks of one gesture are made one
            after the other, first those inside. As long as nothing was clicked inside there is no object.
        **correction
            More of the correction, as of `accelsurf.refine`: ``object``, ``near``, ``new``, ``size``.

        Returns
        -------
        tuple of slice, or None
            The box in which labels have changed.

        Raises
        ------
        UsageError
            When a click is not of a known form, or its object does not exist.
        InputError
            When a click lies outside of the image, takes all that was clicked inside, or the clicks of an interaction
            take too much memory; nothing has changed then.
        """
        named, beside = self._texts("inside", inside), self._texts("outside", outside)
        if self._now.refiner is not None:
            given = {"inside": named, "outside": beside, **correction}
            return self.apply(corrections_of([given])[0])
        if correction:
            raise UsageError(
                f"{', '.join(correction)}: given before there is an object", "click inside it first"
            )
        outside_so_far = (*self._now.outside, *beside)
        if named:
            return self.segment(named, outside_so_far)
        self._check_memory(_size_of(beside))
        read_clicks(beside, "outside", self._volume)
        return self._replace(_State(None, outside_so_far), _size_of(beside))

    def segment(
        self,
        inside: ClickLike | Sequence[ClickLike],
        outside: ClickLike | Sequence[ClickLike] = (),
        **settings: Any,
    ) -> Box | None:
        """Segment an object by clicks, in place of the objects that there are, as one gesture.

        Parameters
        ----------
        inside, outside
            As of `add`.
        **settings
            Of the run, in place of the interaction's: ``size``, ``answer``.
        """
        named, beside = self._texts("inside", inside), self._texts("outside", outside)
        config = self._config.replace(inside=named, outside=beside, **settings)
        self._check_memory(_size_of(named, beside))
        found = finished(Run(self._volume, config, None, self._channels), self._on_step, None)
        return self._replace(_State(Refiner(found)), _size_of(named, beside))

    def start_from(self, labels: ImageLike) -> Box | None:
        """Set the objects to a label map, without clicks, as one gesture; later ones correct them.

        Parameters
        ----------
        labels : image (nz, ny, nx)
            On the grid of the image; 0 outside. Without a voxel inside there is no object.

        Raises
        ------
        InputError
            When the shape is another; GeometryError when the grid is.
        """
        given = np.asarray(array_of(labels, self.geometry, "labels"))
        given = given.astype(np.uint8) if given.dtype == np.bool_ else given
        self._check_memory(given.nbytes)
        state = _State()
        if given.any():
            state = _State(Refiner(beginning_with(self._volume, given)))
        return self._replace(state, given.nbytes)

    def apply(self, correction: Correction) -> Box | None:
        """Correct the objects, begin one beside them, merge, split, remove or mend them, as one gesture.

        Parameters
        ----------
        correction : Correction

        Raises
        ------
        UsageError, InputError
            As of `accelsurf.refine`; nothing has changed then.
        """
        refiner = self._now.refiner
        if refiner is None:
            raise UsageError("there is no object yet to correct", "click inside it first")
        size = _size_of(correction.inside, correction.outside)
        self._check_memory(size)
        before = None if correction.kind == "clicks" else self.labels
        changes = refiner.apply(correction, self._on_step)
        changed = (
            _box_of(changes, refiner.first)
            if before is None
            else bounding_box(before != self.labels)
        )
        self._gestures.append(_Gesture(None, size, changed))
        return changed

    def undo(self) -> Box | None:
        """Take the last gesture back; return the box in which labels have changed, None without one."""
        if not self._gestures:
            return None
        gesture = self._gestures.pop()
        if gesture.before is not None:
            self._now = gesture.before
        elif self._now.refiner is not None:
            self._now.refiner.undo()
        return gesture.changed

    def clear(self) -> Box | None:
        """Forget all gestures; return the box in which labels have changed."""
        changed = self._extent()
        self._now, self._gestures = _State(), []
        return changed

    # -- inner ---------------------------------------------------------------------------------------------

    def _replace(self, state: _State, nbytes: int) -> Box | None:
        """Have other objects, as a gesture."""
        extent = self._extent()
        before, self._now = self._now, state
        changed = _around((extent, self._extent()))
        self._gestures.append(_Gesture(before, nbytes, changed))
        return changed

    def _extent(self) -> Box | None:
        """Return the box around the objects; None where there is none."""
        return None if self._now.refiner is None else bounding_box(self.labels > 0)

    def _texts(self, side: str, given: ClickLike | Sequence[ClickLike]) -> tuple[str, ...]:
        """Return clicks as texts.

        Raises
        ------
        InputError
            When a click is empty or goes beyond the image.
        """
        every = [given] if isinstance(given, (str, Click)) else list(given)
        return tuple(
            each if isinstance(each, str) else voxels_text(_checked(each, self.geometry.shape))
            for each in every
        )

    def _check_memory(self, nbytes: int) -> None:
        budgets.SESSION_CLICKS.check(sum(gesture.nbytes for gesture in self._gestures) + nbytes)


def _size_of(*sides: Sequence[str]) -> int:
    """Return the memory of clicks, bytes."""
    return sum(len(text) for side in sides for text in side)


def _box_of(changes: Sequence[Change], first: Corner) -> Box | None:
    """Return the box of the image in which clicks have changed labels; ``first`` is that of the region of interest."""
    return _around(placed_at(change.box, first) for change in changes if change.voxels)


def _around(boxes: Iterable[Box | None]) -> Box | None:
    """Return the smallest box that holds the boxes that there are; None without any."""
    there = [box for box in boxes if box is not None]
    return functools.reduce(enclosing, there) if there else None


def _checked(click: Click, shape: Sequence[int]) -> Click:
    """Return a click; InputError for one without a voxel, or beyond the image."""
    if not click.mask.any():
        raise InputError("click: no voxel is in it", "name at least one")
    ends = [(side.start, side.stop, n) for side, n in zip(click.box, shape, strict=True)]
    fits = all(None not in (start, stop) and 0 <= start < stop <= n for start, stop, n in ends)
    if not fits or click.mask.shape != tuple(side.stop - side.start for side in click.box):
        raise InputError(
            f"click: its box {click.box} does not fit its mask and the image's shape {tuple(shape)}"
        )
    return click
