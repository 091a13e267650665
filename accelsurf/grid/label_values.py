"""Values of a label map as whole numbers, exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Corner
from accelsurf.grid.image_check import Places

#: A value may differ from a label by this share of it, as scaled by a header; of larger labels by no more than of this.
ROUNDING, MAX_ROUNDED = 1e-4, 1e3
#: Whole numbers up to this are exact as floats of 8 bytes.
MAX_EXACT = 2.0**53


def as_labels(array: NDArray[Any], corner: Corner = (0, 0, 0)) -> NDArray[Any]:
    """The same values in an integer type: those that a header scales by nearly 1 are rounded.

    Parameters
    ----------
    array : ndarray (nz, ny, nx)
    corner : (z, y, x)
        Its first voxel in the whole map, for messages.

    Raises
    ------
    InputError
        When a value is no whole number.
    """
    if array.dtype.kind in "ui":
        return array
    if array.dtype.kind == "b":
        return array.astype(np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):  # some bytes are a NaN that signals
        finite = np.isfinite(array)
        nearest, size = np.rint(array), np.abs(array)
        whole = np.abs(array - nearest) <= np.clip(size, 1.0, MAX_ROUNDED) * ROUNDING
        whole &= finite & (size <= MAX_EXACT)
    places = Places()
    if not finite.all():
        places.add(~finite, corner)
        raise InputError(
            f"labels must be whole numbers, {places} NaN or infinite",
            f"accelsurf look FILE --at {places.at} shows the first; make them 0 in the file",
        )
    if not whole.all():
        places.add(~whole, corner)
        raise InputError(
            f"labels must be whole numbers, {places} not: the first is {float(array[~whole].flat[0]):.9g}",
            hint="is this an image, or a label map resampled with interpolation? resample with nearest neighbour",
        )
    return nearest.astype(np.int32 if size.max() < 2.0**31 else np.int64)
