"""Parts of a surface that have come apart, and objects that have come together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.volume import Volume
from accelsurf.tracking.records import SurfacePiece

#: A part is an object of its own from this part of the largest one's volume on; smaller ones are left out.
OWN_PART = 0.2
#: Two objects become one where they touch along at least this part of the surface of the smaller one.
TOUCHING_PART = 0.1


def separate_parts(surface: SurfacePiece) -> list[SurfacePiece]:
    """The parts of a surface that are connected by faces of voxels, the largest first, without small ones.

    Parameters
    ----------
    surface : SurfacePiece

    Returns
    -------
    list of SurfacePiece
        Of none where nothing is inside; of the surface itself where it is one.
    """
    labels, count = ndimage.label(surface.psi < 0)
    if count == 0:
        return []
    if count == 1:
        return [surface]
    sizes = np.bincount(labels.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")
    large = [int(i) + 1 for i in order if sizes[i] >= OWN_PART * sizes.max()]
    return [_one_part(surface, labels == number) for number in large]


def _one_part(surface: SurfacePiece, inside: NDArray[np.bool_]) -> SurfacePiece:
    """A surface without the voxels inside that are not of one part."""
    return surface._replace(psi=np.where(inside, surface.psi, np.abs(surface.psi))).tight()


def touching(surfaces: Sequence[SurfacePiece], image: Volume, edge: float) -> list[tuple[int, int]]:
    """Pairs of surfaces that have become one, as positions in the list, rising.

    They touch along enough of the smaller one's surface, and the image has no edge between them: its mean there is on
    the object's side of ``edge``.

    Parameters
    ----------
    surfaces : sequence of SurfacePiece
    image : Volume
        The frame.
    edge : float
        Value half-way between objects and what is around them.
    """
    labels = np.zeros(image.geometry.shape, np.int32)
    for place, one in enumerate(surfaces, start=1):
        labels[one.box][one.psi < 0] = place
    inner = float(np.mean(image.array[labels > 0])) if labels.any() else edge
    faces, between = np.zeros(len(surfaces) + 1, np.int64), dict[tuple[int, int], list[float]]()
    for axis, n in enumerate(labels.shape):
        low, high = _layers(labels, axis, 0, n - 1), _layers(labels, axis, 1, n)
        differs = low != high
        a, b = low[differs], high[differs]
        faces += np.bincount(a, minlength=faces.size) + np.bincount(b, minlength=faces.size)
        values = 0.5 * (_layers(image.array, axis, 0, n - 1)[differs] + _layers(image.array, axis, 1, n)[differs])
        for i, j, value in zip(a.tolist(), b.tolist(), values.tolist(), strict=True):
            if i and j:
                between.setdefault((min(i, j), max(i, j)), []).append(value)
    out = []
    for (i, j), there in sorted(between.items()):
        enough = len(there) >= TOUCHING_PART * min(int(faces[i]), int(faces[j]))
        if enough and (float(np.mean(there)) - edge) * (inner - edge) > 0:
            out.append((i - 1, j - 1))
    return out


def _layers(array: NDArray[Any], axis: int, first: int, end: int) -> NDArray[Any]:
    return array[(slice(None),) * axis + (slice(first, end),)]


def groups_of(pairs: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Positions that pairs connect, in groups.

    Examples
    --------
    >>> groups_of([(0, 2), (2, 5), (3, 4)])
    [[0, 2, 5], [3, 4]]
    """
    found: list[set[int]] = []
    for pair in pairs:
        own = set(pair).union(*(one for one in found if one & set(pair)))
        found = [one for one in found if not one & own] + [own]
    return sorted(sorted(one) for one in found)
