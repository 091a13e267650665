"""First surfaces of several objects, each on a small grid of its own: a box of the volume's voxels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Corner, meeting, shared

#: Voxels deeper in a given surface than this part of its greatest depth are surely of the object.
_CORE_DEPTH = 0.5


class ObjectStart(NamedTuple):
    """First surface of the object ``id``: ``psi`` (mm, negative inside) on the voxels from ``corner`` on."""

    id: int
    corner: Corner
    psi: NDArray[np.float32]


def core_of(psi: NDArray[np.float32], spacing: Sequence[float]) -> NDArray[np.bool_]:
    """The voxels inside that are deeper than `_CORE_DEPTH` of the greatest depth; beyond the box an object goes on.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        Negative inside.
    spacing : (hz, hy, hx)
        mm.

    Examples
    --------
    >>> core_of(np.array([[[1, -1, -2, -3, -2, -1, 1]]]), (1.0, 1.0, 1.0)).astype(int)
    array([[[0, 0, 1, 1, 1, 0, 0]]])
    """
    around = [(1, 1) if n > 1 else (0, 0) for n in psi.shape]
    depth = ndimage.distance_transform_edt(np.pad(psi < 0, around, mode="edge"), sampling=spacing)
    depth = depth[tuple(slice(low, n + low) for (low, _), n in zip(around, psi.shape, strict=True))]
    return np.asarray((psi < 0) & (depth > _CORE_DEPTH * depth.max()))


def keep_apart(objects: Sequence[ObjectStart]) -> list[ObjectStart]:
    """Starts without overlap: a voxel of two goes to the one that is deeper there, at a tie to the lower id.

    Of one that lies entirely within others nothing is left.
    """
    out = [segmented._replace(psi=segmented.psi.copy()) for segmented in objects]
    low = np.array([segmented.corner for segmented in objects])
    for i, near in enumerate(
        meeting(low, low + np.array([segmented.psi.shape for segmented in objects]))
    ):
        for j in near:
            segmented, other = objects[i], objects[j]
            both = shared(segmented.corner, segmented.psi.shape, other.corner, other.psi.shape)
            mine, theirs = segmented.psi[both[0]], other.psi[both[1]]
            separated = out[i].psi[both[0]]
            np.maximum(separated, 0.5 * (mine - theirs), out=separated)
            # Just off the boundary where both are equally deep.
            separated[(mine == theirs) & (mine < 0)] = -1e-3 if i < j else 1e-3
    return out


def separated(objects: list[ObjectStart], name: str) -> list[ObjectStart]:
    """Starts without overlap, as of `keep_apart`.

    Raises
    ------
    InputError
        When nothing is left of one.
    """
    out = keep_apart(objects)
    for start in out:
        if not (start.psi < 0).any():
            raise InputError(
                f"objects {name}: all of object {start.id} lies within others",
                "move them apart, or give smaller ones",
            )
    return out
