"""Types of arrays and of small tuples that all rooms use, each named once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Numbers in double precision: places, lengths, sums.
Floats = NDArray[np.float64]
#: Numbers in single precision: fields on voxels.
Singles = NDArray[np.float32]
#: Voxels, or items of any list, that are meant.
Mask = NDArray[np.bool_]
#: Values of an image as a run has them, (nz, ny, nx).
Image = NDArray[np.float32]
#: Signed distance from a surface, mm, negative inside, (nz, ny, nx).
Psi = NDArray[np.float32]
#: Numbers of the points of each triangle of a mesh, (m, 3).
Faces = NDArray[np.int32]
#: Whole numbers, such as indices of voxels.
Ints = NDArray[np.int64]
#: Size of a voxel (hz, hy, hx), mm.
Spacing = tuple[float, float, float]
