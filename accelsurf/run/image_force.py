"""The force of the image in a slice, without its curvature, wherever the surface may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import corner_of
from accelsurf.run.evolving_object import EvolvingObject
from accelsurf.run.run import Run

#: Pixels along a side of a block of a slice aslant.
BLOCK = 32
#: A slice of the grid, or the voxels of one aslant.
Plane = tuple[int, int] | NDArray[np.int64]


def image_forces(
    run: Run, planes: Sequence[Plane], object_id: int | None = None, is_measured: bool = False
) -> list[NDArray[np.float32]] | None:
    """The force of an object's energy in slices of the image, outward: above 0 a surface there would grow.

    Means and models are those of the present surface. Changes nothing.

    Parameters
    ----------
    run : Run
    planes : sequence of (int, int) or ndarray (rows, columns, 3)
        Array axis (of z, y, x) and index of each slice; or of a slice aslant the voxel (z, y, x) at each of its pixels,
        which may lie beyond the image.
    object_id : int, optional
        Of several objects; the first unless given.
    is_measured : bool, optional
        The run is as it was when this was called last for this object: means and models are those of then.

    Returns
    -------
    list of ndarray, or None
        (rows, columns); NaN where it is not known, as beyond the region of interest. None where the energy
        does not tell, or there is no surface.
    """
    evolving = next((evolving for evolving in run.objects if object_id in (None, evolving.id)), run.objects[0])
    if evolving.surface.size == 0:
        return None
    if not is_measured:
        evolving.evolution.initialize()
        evolving.evolution.energy.value(evolving.surface, *evolving.surface.fraction_and_area())
    forces = [
        _at_voxels(run, evolving, plane) if isinstance(plane, np.ndarray) else _in_slice(run, evolving, *plane)
        for plane in planes
    ]
    return None if any(force is None for force in forces) else [force for force in forces if force is not None]


def _in_slice(run: Run, evolving: EvolvingObject, axis: int, index: int) -> NDArray[np.float32] | None:
    surface, places = evolving.surface, _places(run, evolving)
    shape = [n for other, n in enumerate(run.volume.geometry.shape) if other != axis]
    out = np.full(shape, np.nan, np.float32)
    at = places[axis][index]
    if at < 0:
        return out
    box = tuple(slice(at, at + 1) if other == axis else slice(0, n) for other, n in enumerate(surface.shape))
    force = evolving.evolution.energy.image_force(surface, (box[0], box[1], box[2]))
    if force is None:
        return None
    rows, columns = (part for other, part in enumerate(places) if other != axis)
    known = np.ix_(rows >= 0, columns >= 0)
    flat: NDArray[np.float32] = -np.squeeze(force, axis=axis)
    out[known] = flat[np.ix_(rows[rows >= 0], columns[columns >= 0])]
    return out


def _at_voxels(run: Run, evolving: EvolvingObject, voxels: NDArray[np.int64]) -> NDArray[np.float32] | None:
    """The force at voxels (rows, columns, 3), by blocks: the box of all of a slice aslant may be the whole image."""
    out: NDArray[np.float32] = np.full((len(voxels), voxels.shape[1]), np.nan, np.float32)
    inside = np.all((voxels >= 0) & (voxels < np.array(run.volume.geometry.shape)), axis=-1)
    places = np.full(voxels.shape, -1, np.int64)
    for axis, place in enumerate(_places(run, evolving)):
        places[..., axis][inside] = place[voxels[..., axis][inside]]
    known = np.all(places >= 0, axis=-1)
    rows, columns = out.shape
    for row in range(0, rows, BLOCK):
        for column in range(0, columns, BLOCK):
            part = (slice(row, row + BLOCK), slice(column, column + BLOCK))
            at = places[part][known[part]]
            if not len(at):
                continue
            low, high = at.min(axis=0), at.max(axis=0) + 1
            z, y, x = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
            force = evolving.evolution.energy.image_force(evolving.surface, (z, y, x))
            if force is None:
                return None
            out[part][known[part]] = -force[tuple((at - low).T)]
    return out


def _places(run: Run, evolving: EvolvingObject) -> list[NDArray[np.int64]]:
    """For each voxel of the image along each axis, the nearest one of the object's grid; -1 where there is none."""
    level, first = run.grid, corner_of(run.prepared.box)
    places = []
    for axis, n in enumerate(run.volume.geometry.shape):
        within = (np.arange(n) - first[axis] - level.first[axis]) / level.factors[axis]
        place = np.rint(within).astype(np.int64) - evolving.corner[axis]
        in_region = (np.arange(n) >= first[axis]) & (np.arange(n) < run.prepared.box[axis].stop)
        known = in_region & (place >= 0) & (place < evolving.surface.shape[axis])
        places.append(np.where(known, place, -1))
    return places
