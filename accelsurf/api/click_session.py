"""ClickSession: an object of an image in memory, found click by click, with every click undone at will."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks.model import ClickModel, Scene, click_model
from accelsurf.clicks.model.given import GivenMask, corrected_model, model_of_mask
from accelsurf.errors import InputError
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    box_at,
    corner_of,
    enclosing,
    placed_at,
    whole_box,
)
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.image.volume import Volume, check_images
from accelsurf.io.library_images import ImageLike, array_of, as_volume
from accelsurf.run.preprocessing import apply, filtered_volume, filters_of, scale_of
from accelsurf.settings import budgets
from accelsurf.settings.run_config import RunConfig

#: Models of earlier steps are stored up to so many bytes; those before them are made again when a step is undone.
STORED_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class _Step:
    """The object after a step.

    Attributes
    ----------
    given : GivenMask or None
        Labels that the object began at.
    added : tuple of Click
        The step's own clicks.
    clicks : Clicks
        All clicks that are in force.
    model : ClickModel or None
        None where nothing is clicked inside.
    is_stored : bool
        The model is in memory.
    """

    given: GivenMask | None
    added: tuple[Click, ...]
    clicks: Clicks
    model: ClickModel | None = None
    is_stored: bool = True

    @property
    def nbytes(self) -> int:
        """Memory of the model."""
        return 0 if self.model is None else self.model.field.nbytes + self.model.inside.nbytes

    @property
    def nbytes_given(self) -> int:
        """Memory of the clicks or labels that were given in this step."""
        if self.added:
            return sum(click.mask.nbytes for click in self.added)
        return 0 if self.given is None else self.given.mask.nbytes


class ClickSession:
    """An object in an image, found click by click; a click takes parts of a second.

    The labels are those of the model of the clicks: the first surface of `accelsurf.segment` with the same clicks,
    which has not moved yet. Each step can be undone.

    Parameters
    ----------
    image : image
        As `accelsurf.segment` takes it; never modified. A 2D array is one slice.
    spacing : float, str or (hz, hy, hx), optional
        mm, for an array only; 1 by default.
    channels : sequence of image, optional
        Further ones, on the same grid.

    Attributes
    ----------
    geometry : Geometry
        The image's grid.

    Raises
    ------
    InputError
        When an image cannot be used; GeometryError when a channel lies on another grid.

    Examples
    --------
    >>> import numpy as np
    >>> image = 100.0 * (((np.indices((24, 24, 24)) - 11.5) ** 2).sum(axis=0) < 8**2)
    >>> session = ClickSession(image)
    >>> ball = Click("inside", (slice(9, 15),) * 3, np.ones((6, 6, 6), bool))
    >>> session.add([ball])
    (slice(4, 20, None), slice(4, 20, None), slice(4, 20, None))
    >>> bool((session.labels == (image > 50)).all())
    True
    >>> session.undo() is not None, bool(session.labels.any())
    (True, False)
    """

    def __init__(
        self,
        image: ImageLike,
        *,
        spacing: float | str | tuple[float, float, float] | None = None,
        channels: Sequence[ImageLike] = (),
    ) -> None:
        volume = as_volume(image, spacing)
        self.geometry = volume.geometry
        others = [
            volume.with_array(array_of(channel, self.geometry, "channel")) for channel in channels
        ]
        self._scene = Scene(_scaled([volume, *others]), self.geometry.spacing)
        self._steps = [_Step(None, (), Clicks((), self.geometry.shape))]
        self._spent = 0

    @property
    def labels(self) -> NDArray[np.uint8]:
        """The object (nz, ny, nx): 1 inside, 0 elsewhere."""
        return self.labels_on(whole_box(self.geometry.shape))

    def labels_on(self, box: Box) -> NDArray[np.uint8]:
        """Return the object's labels on a box of the grid."""
        model = self._steps[-1].model
        if model is None:
            return np.zeros([side.stop - side.start for side in box], np.uint8)
        return model.inside_on(box).astype(np.uint8)

    @property
    def count(self) -> int:
        """Number of steps that can be undone."""
        return len(self._steps) - 1

    def add(self, clicks: Sequence[Click]) -> Box | None:
        """Add clicks, one after the other, as one step.

        A click takes the voxels that it contradicts from earlier ones. Where nothing is left that is clicked inside,
        there is no object.

        Parameters
        ----------
        clicks : sequence of Click
            On the grid, with the default id.

        Returns
        -------
        tuple of slice, or None
            The box in which labels have changed.

        Raises
        ------
        InputError
            When a click is empty or goes beyond the image, or the clicks of a session take too much memory.
        """
        for click in clicks:
            _check(click, self.geometry.shape)
        budgets.SESSION_CLICKS.check(self._spent + sum(click.mask.nbytes for click in clicks))
        return self._append(self._after(self._steps[-1], clicks))

    def start_from(self, labels: ImageLike) -> Box | None:
        """Set the object to given labels, without clicks, as one step; later clicks correct it.

        Parameters
        ----------
        labels : image (nz, ny, nx)
            On the grid of the image; not 0 inside.

        Returns
        -------
        tuple of slice, or None
            The box in which labels have changed.

        Raises
        ------
        InputError
            When the shape is another; GeometryError when the grid is.
        """
        mask = np.asarray(array_of(labels, self.geometry, "labels") != 0)
        box = bounding_box(mask) or box_at((0, 0, 0), (1, 1, 1))
        given = GivenMask(box, np.ascontiguousarray(mask[box]))
        budgets.SESSION_CLICKS.check(self._spent + given.mask.nbytes)
        clicks = Clicks((), self.geometry.shape)
        return self._append(_Step(given, (), clicks, self._model_of(given)))

    def undo(self) -> Box | None:
        """Take the last step back; return the box in which labels have changed, None without one."""
        if not self.count:
            return None
        before = self._steps.pop()
        self._spent -= before.nbytes_given
        self._restore(len(self._steps) - 1)
        return _changed(before.model, self._steps[-1].model)

    def clear(self) -> Box | None:
        """Forget all steps; return the box in which labels have changed."""
        before, self._steps, self._spent = self._steps[-1], self._steps[:1], 0
        return _changed(before.model, None)

    # -- steps ---------------------------------------------------------------------------------------------

    def _append(self, step: _Step) -> Box | None:
        before = self._steps[-1].model
        self._steps.append(step)
        self._spent += step.nbytes_given
        self._release()
        return _changed(before, step.model)

    def _after(self, before: _Step, added: Sequence[Click]) -> _Step:
        """Return the step after some more clicks."""
        clicks, model = before.clicks, before.model
        for click in added:
            clicks = clicks.with_later([click])
            if (
                model is not None
            ):  # what earlier clicks have said stays, but for the voxels that this one takes
                model = replace(model, clicks=Clicks(clicks.clicks[:-1], clicks.shape))
            model = self._model(before.given, clicks, model)
        return _Step(before.given, tuple(added), clicks, model)

    def _model(
        self, given: GivenMask | None, clicks: Clicks, before: ClickModel | None
    ) -> ClickModel | None:
        """Return the model after the last click; ``before`` is that of the clicks before it."""
        if given is None:
            return click_model(self._scene, clicks, previous=before) if clicks.ids() else None
        return corrected_model(self._scene, given, clicks, previous=before)

    def _model_of(self, given: GivenMask) -> ClickModel:
        return model_of_mask(given, self.geometry.shape, self.geometry.spacing)

    def _restore(self, number: int) -> None:
        """Make the model of a step again where it is not in memory, from the last one that is."""
        first = number
        while not self._steps[first].is_stored and self._steps[first].added:
            first -= 1
        for place in range(first, number + 1):
            step = self._steps[place]
            if step.is_stored:
                continue
            if step.added:
                self._steps[place] = self._after(self._steps[place - 1], step.added)
            elif step.given is not None:
                self._steps[place] = replace(step, model=self._model_of(step.given), is_stored=True)
        self._release()

    def _release(self) -> None:
        """Release the oldest models beyond the memory for them."""
        used = sum(step.nbytes for step in self._steps)
        for place, step in enumerate(self._steps[:-1]):
            if used <= STORED_BYTES:
                return
            if step.model is not None:
                self._steps[place] = replace(step, model=None, is_stored=False)
                used -= step.nbytes


def _scaled(channels: Sequence[Volume]) -> tuple[NDArray[np.float32], ...]:
    """The channels as a run sees them: checked, filtered, 0 and 1 at their percentiles."""
    out, config = [], RunConfig()
    check_images(channels)
    for channel in channels:
        values = filtered_volume(channel, filters_of(config, channel.geometry))
        out.append(apply(values, scale_of(values)))
    return tuple(out)


def _check(click: Click, shape: Sequence[int]) -> None:
    """Refuse a click without a voxel, or beyond the image."""
    if not click.mask.any():
        raise InputError("click: no voxel is in it", "name at least one")
    ends = [(side.start, side.stop, n) for side, n in zip(click.box, shape, strict=True)]
    fits = all(None not in (start, stop) and 0 <= start < stop <= n for start, stop, n in ends)
    if not fits or click.mask.shape != tuple(side.stop - side.start for side in click.box):
        raise InputError(
            f"click: its box {click.box} does not fit its mask and the image's shape {tuple(shape)}"
        )


def _changed(before: ClickModel | None, after: ClickModel | None) -> Box | None:
    """Return the box in which the object of one model is not that of another; None where they agree."""
    models = [model for model in (before, after) if model is not None]
    if not models or before is after:
        return None
    box = models[0].box if len(models) == 1 else enclosing(models[0].box, models[1].box)
    differs = np.zeros([side.stop - side.start for side in box], np.bool_)
    for model in models:
        differs ^= model.inside_on(box)
    tight = bounding_box(differs)
    return None if tight is None else placed_at(tight, corner_of(box))
