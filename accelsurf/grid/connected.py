"""Pieces of a mask, connected through faces of voxels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


def connected_to(mask: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pieces of a mask that have a voxel of ``seeds``; both (nz, ny, nx) of bool.

    Examples
    --------
    >>> row = np.array([[[True, True, False, True]]])
    >>> connected_to(row, np.array([[[True, False, True, False]]]))
    array([[[ True,  True, False, False]]])
    """
    labels, count = ndimage.label(mask)
    own = np.zeros(count + 1, np.bool_)
    own[labels[seeds]] = True
    own[0] = False
    return own[labels]
