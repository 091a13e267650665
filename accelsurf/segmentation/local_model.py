"""The clicks' model of an object that is corrected: which voxels another click wins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.seeded import SeededModel, seeded_model
from accelsurf.grid.boxes import Box, bounding_box, box_at
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.segmentation.preprocessing import uses_model
from accelsurf.segmentation.run_setup import thread_count
from accelsurf.segmentation.run_state import RunState
from accelsurf.settings.run_config import RunConfig

Image = NDArray[np.float32]
Spacing = tuple[float, float, float]


class ModelChange(NamedTuple):
    """What a click changed: the ``mask`` on a ``box`` of the grid where F has another side, and the model before."""

    box: Box
    mask: NDArray[np.bool_]
    before: SeededModel


class LocalModel:
    """The model of an object, click by click.

    Parameters
    ----------
    model : SeededModel
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    passes : ndarray of bool or None
        The mask of the run.
    threads : int
        The result is the same for any number.
    """

    def __init__(
        self,
        model: SeededModel,
        images: Sequence[Image],
        spacing: Spacing,
        passes: NDArray[np.bool_] | None,
        threads: int,
    ) -> None:
        self.model = model
        self._images, self._spacing, self._passes, self._threads = images, spacing, passes, threads

    @property
    def field(self) -> Image:
        """F (nz, ny, nx): the surface grows where it is below 0."""
        return self.model.field

    def add(self, click: Click) -> ModelChange:
        """Go on to the model with one more click.

        Parameters
        ----------
        click : Click
            On the grid of the model, as its object sees it.
        """
        before = self.model
        self.model = seeded_model(
            self._images,
            self._spacing,
            before.clicks.with_more([click]),
            mask=self._passes,
            threads=self._threads,
            previous=before,
        )
        changed = (self.model.field < 0) != (before.field < 0)
        box = bounding_box(changed) or box_at((0, 0, 0), (0, 0, 0))
        return ModelChange(box, changed[box], before)

    def undo(self, change: ModelChange) -> None:
        """Take back the last change."""
        self.model = change.before


def basin_of(click: Click, change: ModelChange, field: Image) -> Click:
    """What a click wins, as a click: its voxels, and those connected to it whose field is now on its side by it.

    Parameters
    ----------
    click : Click
    change : ModelChange
        That it made.
    field : ndarray (nz, ny, nx), float32
        After the click.
    """
    side = (field < 0) if click.side == "inside" else (field > 0)
    corners = np.array([[t.start for t in click.box], [t.start for t in change.box]])
    ends = np.array([[t.stop for t in click.box], [t.stop for t in change.box]])
    if not change.mask.size:
        return click
    low, high = corners.min(axis=0), ends.max(axis=0)
    box = box_at((int(low[0]), int(low[1]), int(low[2])), [int(n) for n in high - low])
    own = np.zeros(tuple(t.stop - t.start for t in box), np.bool_)
    own[tuple(slice(t.start - b.start, t.stop - b.start) for t, b in zip(change.box, box, strict=True))] = change.mask
    own &= side[box]
    (placed,) = Clicks((click,), (field.shape[0], field.shape[1], field.shape[2])).on_box(box).clicks
    own[placed.box] |= placed.mask
    labels, _ = ndimage.label(own)
    found = np.unique(labels[placed.box][placed.mask])
    return click._replace(box=box, mask=np.asarray(np.isin(labels, found[found > 0])))


def local_models(state: RunState, settings: RunConfig, ids: Sequence[int]) -> dict[int, LocalModel]:
    """The models of a finished run's objects, by id; none where the energy has no such term."""
    if not uses_model(settings):
        return {}
    prepared = state.prepared
    distance = prepared.mask_distance
    passes = None if distance is None else np.asarray(distance < 0)
    models = {id: state.models.get(id) or state.contexts[id].seeded_model() for id in ids}
    return {
        id: LocalModel(model, prepared.images, prepared.geometry.spacing, passes, thread_count(settings))
        for id, model in models.items()
    }
