"""Pieces of a mask, connected through faces of voxels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import bounding_box


def connected_to(mask: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pieces of a mask that have a voxel of ``seeds``; both (nz, ny, nx) of bool.

    Examples
    --------
    >>> row = np.array([[[True, True, False, True]]])
    >>> connected_to(row, np.array([[[True, False, True, False]]]))
    array([[[ True,  True, False, False]]])
    """
    out = np.zeros(mask.shape, np.bool_)
    box = bounding_box(mask)
    if box is None:
        return out
    labels, count = ndimage.label(mask[box])
    is_seeded = np.zeros(count + 1, np.bool_)
    is_seeded[labels[seeds[box]]] = True
    is_seeded[0] = False
    out[box] = is_seeded[labels]
    return out


def holes_filled(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (nz, ny, nx) with what it encloses: what is connected to no face of the grid.

    In an image of one slice nothing is enclosed: all of it lies at a face.

    Examples
    --------
    >>> shell = np.ones((3, 3, 3), bool)
    >>> shell[1, 1, 1] = False
    >>> bool(holes_filled(shell).all())
    True
    """
    out = np.array(mask, np.bool_)
    box = bounding_box(out)
    if box is None:
        return out
    # One layer around is all of the outside, which has the first label then: it has the first voxel.
    labels, _ = ndimage.label(np.pad(~out[box], 1, constant_values=True))
    out[box] = labels[1:-1, 1:-1, 1:-1] != 1
    return out
