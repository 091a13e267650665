"""A surface between two corrections, and the voxels of clicks that are on the wrong side of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution import StepRecord, Stop
from accelsurf.grid.boxes import Box, Corner, corner_of, counted_from
from accelsurf.run import AROUND, EarlierProbability, PreprocessedInput, Result, SegmentedObject
from accelsurf.settings.flow_specs import AUTO
from accelsurf.settings.run_config import RunConfig


class CorrectedSurface(NamedTuple):
    """A surface between two corrections, as a value: psi (nz, ny, nx) from voxel ``corner`` of the region of interest.

    ``inside`` is the number of its voxels; ``before`` the least probability before its corrections by clicks.
    """

    id: int
    corner: Corner
    psi: NDArray[np.float32]
    inside: int
    history: list[StepRecord]
    stop: Stop
    before: EarlierProbability | None = None


def surface_of(segmented: SegmentedObject, region: Box) -> CorrectedSurface:
    """The surface of an object of a result on the grid of its region of interest, as a copy."""
    box = tuple(
        slice(max(s.start, r.start), min(s.stop, r.stop))
        for s, r in zip(segmented.box, region, strict=True)
    )
    psi = np.array(
        segmented.psi[counted_from((box[0], box[1], box[2]), corner_of(segmented.box))],
        np.float32,
        order="C",
    )
    z, y, x = (s.start - r.start for s, r in zip(box, region, strict=True))
    return CorrectedSurface(
        segmented.id,
        (z, y, x),
        psi,
        count_inside(psi),
        segmented.history,
        segmented.stop,
        segmented.before,
    )


def frozen_settings(result: Result) -> RunConfig:
    """The settings at the end of a run, with numbers in place of settings that were measured on the whole image."""
    done = result.config.edit[: result.edits_done]
    settings = result.config.replace(edit=done).at(max((edit.step for edit in done), default=0))
    contrasts = [
        term["contrast"]
        for term in result.objects[0].terms
        if isinstance(term.get("contrast"), float)
    ]
    if settings.edge_contrast == "auto" and contrasts:
        settings = settings.replace(edge_contrast=contrasts[0])
    if settings.flow == AUTO:
        settings = settings.replace(flow=result.resolved_settings["flow"])
    return settings.replace(refine=())


def count_inside(psi: NDArray[np.float32]) -> int:
    """Number of voxels inside."""
    return int(np.count_nonzero(psi < 0))


def part_of_image(
    before: Box, corner: Corner, now: CorrectedSurface, prepared: PreprocessedInput
) -> Box:
    """The part of the image of one of several objects after a correction.

    The part ``before``, and its array, from voxel ``corner`` of the image on; with room beyond the region of
    interest where that cuts the object.
    """
    out = []
    image = prepared.volumes[0].geometry.shape
    for old, c, n, region, whole in zip(
        before, corner, now.psi.shape, prepared.box, image, strict=True
    ):
        low = c - (AROUND if c == region.start else 0)
        high = c + n + (AROUND if c + n == region.stop else 0)
        out.append(slice(max(min(low, old.start), 0), min(max(high, old.stop), whole)))
    return out[0], out[1], out[2]


def stop_of_whole(stop: Stop, inside: int, voxels: int) -> Stop:
    """Why a correction ended, of the whole object: a part of it that is gone is not the whole."""
    if inside == 0:
        return stop._replace(reason="vanished", message="the corrected object has no voxel left")
    if inside == voxels:
        return stop._replace(reason="filled", message="the corrected object fills the whole volume")
    if stop.reason in ("vanished", "filled"):
        return stop._replace(
            reason="converged", message="the correction left no surface near the click"
        )
    return stop
