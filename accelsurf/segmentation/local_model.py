"""The clicks' model of an object that is corrected: a later click changes its arrays only where it arrives first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.seeded.appearance import learn
from accelsurf.energies.seeded.competition import arrival, balance, field_of
from accelsurf.energies.seeded.model import CLICKED, EARLIER, SMOOTHING, SeededModel
from accelsurf.grid.boxes import Box, widened
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.smoothing import gaussian_mm
from accelsurf.segmentation.preprocessing import uses_model
from accelsurf.segmentation.run_state import RunState
from accelsurf.settings.run_config import RunConfig

#: First half width, voxels, of the box in which a click's march is followed; it doubles while the march comes to its
#: edge.
FIRST_REACH = 12
#: Voxels beyond that box that smoothing and appearance see.
CONTEXT = 4

Image = NDArray[np.float32]
Spacing = tuple[float, float, float]


class ModelChange(NamedTuple):
    """What a click changed: the ``mask`` on a ``box`` of the grid, and the arrays there before."""

    box: Box
    mask: NDArray[np.bool_]
    before: tuple[Image, Image, Image]


class LocalModel:
    """The arrays of a `SeededModel`, changed click by click.

    Parameters
    ----------
    model : SeededModel
        Not changed.
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    passes : ndarray of bool or None
        The mask of the run.
    """

    def __init__(
        self, model: SeededModel, images: Sequence[Image], spacing: Spacing, passes: NDArray[np.bool_] | None
    ) -> None:
        self._model, self._images, self._spacing, self._passes = model, images, spacing, passes
        self._arrays = [model.field, model.times_in, model.times_out]
        self._owned = False

    @property
    def field(self) -> Image:
        """F (nz, ny, nx): the surface grows where it is below 0."""
        return self._arrays[0]

    def model(self) -> SeededModel:
        """The model as a value: later changes do not change it."""
        self._owned = False
        field, times_in, times_out = self._arrays
        return SeededModel(
            field, self._model.start, times_in, times_out, self._model.proposal, self._model.area_weight_mm,
            self._model.clicks,
        )

    def add(self, click: Click) -> ModelChange:
        """Change the model where a click arrives earlier than all before, by the march of `seeded_model`.

        Parameters
        ----------
        click : Click
            On the grid of the model, as its object sees it.
        """
        reach, shape = FIRST_REACH, self.field.shape
        while True:
            box = widened(click.box, shape, (reach, reach, reach))
            change = self._within(click, box)
            if not _meets_edge(change[3], box, shape):
                break
            reach *= 2
        self._own()
        before = tuple(array[box].copy() for array in self._arrays)
        for array, new in zip(self._arrays, change[:3], strict=True):
            array[box] = new
        return ModelChange(box, change[3], (before[0], before[1], before[2]))

    def undo(self, change: ModelChange) -> None:
        """Take back the last change."""
        self._own()
        for array, old in zip(self._arrays, change.before, strict=True):
            array[change.box] = old

    def _own(self) -> None:
        """Copy the arrays once, so that the model they came from stays as it is."""
        if not self._owned:
            self._arrays, self._owned = [array.copy() for array in self._arrays], True

    def _within(self, click: Click, box: Box) -> tuple[Image, Image, Image, NDArray[np.bool_]]:
        """Field and times of arrival on a box after a click, and where the field changed."""
        wide = widened(box, self.field.shape, (CONTEXT, CONTEXT, CONTEXT))
        inner = tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(box, wide, strict=True))
        images = [gaussian_mm(image[wide], self._spacing, SMOOTHING * min(self._spacing)) for image in self._images]
        shape = (wide[0].stop - wide[0].start, wide[1].stop - wide[1].start, wide[2].stop - wide[2].start)
        (placed,) = Clicks((click,), self.field.shape).on_box(wide).clicks
        field, times_in, times_out = (array[wide] for array in self._arrays)
        passes = np.zeros(shape, np.bool_)
        passes[inner] = True if self._passes is None else self._passes[box]
        seeds = np.flatnonzero(Clicks((placed,), shape).mask(placed.side))
        cap = np.asarray(EARLIER * np.minimum(times_in, times_out), np.float32).ravel()
        times, _ = arrival(field_of(images, self._spacing, passes), learn(images, self._spacing, placed), seeds, cap)
        nearer = balance(times, cap).reshape(shape)
        inside = click.side == "inside"
        force = np.minimum(field, nearer) if inside else np.maximum(field, -nearer)
        force[placed.box][placed.mask] = -CLICKED if inside else CLICKED
        earlier = np.minimum(times_in if inside else times_out, times.reshape(shape))
        pair = (earlier, times_out) if inside else (times_in, earlier)
        return force[inner], pair[0][inner], pair[1][inner], np.asarray((force != field)[inner])


def _meets_edge(changed: NDArray[np.bool_], box: Box, shape: Sequence[int]) -> bool:
    """Whether a change comes to a face of a box that is not the grid's own."""
    for axis, (side, n) in enumerate(zip(box, shape, strict=True)):
        if side.start > 0 and changed.take(0, axis=axis).any():
            return True
        if side.stop < n and changed.take(-1, axis=axis).any():
            return True
    return False


def basin_of(click: Click, box: Box, changed: NDArray[np.bool_], field: Image) -> NDArray[np.bool_]:
    """Voxels of a box that a click wins: where the changed field is on its side, connected to it.

    Parameters
    ----------
    click : Click
    box : tuple of slice
        Has the click.
    changed : ndarray of bool
        Where the click changed the field, on the box.
    field : ndarray, float32
        On the box, after the click.
    """
    (placed,) = Clicks((click,), tuple(s.stop for s in box)).on_box(box).clicks  # type: ignore[arg-type]
    own = changed & ((field < 0) if click.side == "inside" else (field > 0))
    own[placed.box] |= placed.mask
    labels, _ = ndimage.label(own)
    found = np.unique(labels[placed.box][placed.mask])
    return np.asarray(np.isin(labels, found[found > 0]))


def local_models(state: RunState, settings: RunConfig, ids: Sequence[int]) -> dict[int, LocalModel]:
    """The models of a finished run's objects, by id; none where the energy has no such term."""
    if not uses_model(settings):
        return {}
    prepared = state.prepared
    distance = prepared.mask_distance
    passes = None if distance is None else np.asarray(distance < 0)
    models = {id: state.models.get(id) or state.contexts[id].seeded_model() for id in ids}
    return {
        id: LocalModel(model, prepared.images, prepared.geometry.spacing, passes) for id, model in models.items()
    }
