"""The arrival times of a press in an object: the march of a run with clicks, from what was pressed alone."""

from __future__ import annotations

import numpy as np

from accelsurf.energies.seeded.appearance import learn
from accelsurf.energies.seeded.competition import arrival, field_of
from accelsurf.energies.seeded.model import SMOOTHING
from accelsurf.errors import UsageError
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.smoothing import gaussian_mm
from accelsurf.initialization.clicks import read_clicks
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_state import BoxMask
from accelsurf.viewer.core.size_drag import FIRST_VOXELS, SizeDrag


def size_drag_of(run: Run, ball: str, voxels: int = FIRST_VOXELS, taken: BoxMask | None = None) -> SizeDrag:
    """Compute the arrival times from a ball.

    Parameters
    ----------
    run : Run
        Its image and settings are used; it is not changed.
    ball : str
        ``ball:X,Y,Z,R``.
    voxels : int, optional
        How many are reached.
    taken : BoxMask, optional
        Voxels of the region of interest that belong to other objects: the march goes around them.

    Raises
    ------
    UsageError, InputError
        When it is no ball, or lies outside.
    """
    if not ball.startswith("ball:"):
        raise UsageError(f"press: {ball[:40]!r} was given, expected ball:X,Y,Z,R")
    clicks = read_clicks([ball], "inside", run.volume)
    geometry, box = run.volume.geometry, run.prepared.box
    context = run.objects[0].context
    (click,) = Clicks(tuple(clicks), geometry.shape).on_box(box).clicks or (None,)
    if click is None:
        raise UsageError(f"press: {ball} lies outside of the mask")
    spacing = context.spacing
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in context.images]
    shape = smooth[0].shape
    distance = run.prepared.mask_distance
    passes = None if distance is None else np.asarray(distance < 0)
    if taken is not None:
        passes = np.ones(shape, np.bool_) if passes is None else passes
        passes[taken.box] &= ~taken.mask
    field = field_of(smooth, spacing, passes)
    where = tuple(axis + part.start for axis, part in zip(np.nonzero(click.mask), click.box, strict=True))
    seeds = np.ravel_multi_index(where, shape).astype(np.int64)
    tissue = learn(smooth, spacing, click)
    times, order = arrival(field, tissue, seeds, max_count=voxels)
    axis = geometry.slice_axis
    thickness = None if axis is None else geometry.spacing[axis]
    return SizeDrag(ball, times.reshape(shape), order, run.prepared.first, geometry.voxel_volume, thickness)
