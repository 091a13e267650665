"""Checks of voxels before a run: an image has something to segment, a label map has whole numbers.

An image is checked in one pass over its planes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.boxes import Corner

#: Least number of values of an image in single precision, unless it has fewer itself.
MIN_STEPS = 256
MAX_VALUE = 1e30
MIN_RANGE = 1e-30
"""Values beyond the first mean "no value" in many files, and their squares are beyond 32-bit floats; so is the inverse
of a range below the second."""

#: A value may differ from a label by this share of it, as scaled by a header; of larger labels by no more than of this.
ROUNDING = 1e-4
MAX_ROUNDED = 1e3
#: Whole numbers up to this are exact as floats of 8 bytes.
MAX_EXACT = 2.0**53


class ImageCheck:
    """Check of the voxels of an image; planes are added from the first to the last.

    Attributes
    ----------
    low, high : scalar or None
        Extremes so far, of the image's own dtype.

    Examples
    --------
    >>> check = ImageCheck()
    >>> check.add(np.array([[[0, 1], [1, 0]]]))
    >>> check.refuse()
    """

    def __init__(self) -> None:
        self.low: Any = None
        self.high: Any = None
        self._planes = 0
        self._nans = 0
        self._nonfinite, self._beyond = Places(), Places()

    def add(self, planes: NDArray[Any]) -> None:
        """Look at the next planes (n, ny, nx)."""
        if planes.dtype.kind == "f" and not np.isfinite(planes).all():
            self._nans += int(np.isnan(planes).sum())
            self._nonfinite.add(~np.isfinite(planes), (self._planes, 0, 0))
        low, high = planes.min(), planes.max()
        if max(float(high), -float(low)) > MAX_VALUE:
            self._beyond.add(np.abs(planes) > MAX_VALUE, (self._planes, 0, 0))
        self.low = low if self.low is None else min(self.low, low)
        self.high = high if self.high is None else max(self.high, high)
        self._planes += len(planes)

    def refuse_nonfinite(self) -> None:
        """Refuse voxels that are NaN or infinite; `InputError` with their number and the first place."""
        count = self._nonfinite.count
        if count:
            raise InputError(
                f"{self._nonfinite} not finite ({self._nans} NaN, {count - self._nans} infinite)",
                hint=f"accelsurf look IMAGE --at {self._nonfinite.at} shows the first; replace them by numbers, in "
                "Python: volume.with_array(numpy.nan_to_num(volume.array, posinf=0, neginf=0))",
            )

    def refuse(self) -> None:
        """Refuse an image that nothing can be segmented from, when all planes were added.

        Raises
        ------
        InputError
            When a voxel is NaN, infinite or beyond `MAX_VALUE`, when their range is below `MIN_RANGE`, or when all
            voxels have the same value.
        """
        self.refuse_nonfinite()
        low, high = self.low, self.high
        if self._beyond.count:
            raise InputError(
                f"{self._beyond} beyond {MAX_VALUE:g} ({low:g} to {high:g})",
                hint="such values often mean that there is no value: replace them by that of the background",
            )
        if 0.0 < float(high) - float(low) < MIN_RANGE:
            raise InputError(
                f"the image has values from {low:g} to {high:g}, a range of at least {MIN_RANGE:g} expected",
                hint="rescale the image, e.g. divide it by its largest value",
            )
        self._refuse_indistinct()
        if low == high:
            raise InputError(
                f"the image is constant: every voxel is {low}",
                hint="object and background have the same value; is this the right file?",
            )

    def _refuse_indistinct(self) -> None:
        """Refuse an image whose values are nearly the same in single precision, in which it is computed.

        Taking an offset away unasked would make bounds and results speak of other numbers than the file has.
        """
        low, high = self.low, self.high
        step = float(np.spacing(np.float32(max(abs(float(low)), abs(float(high))))))
        span = int(high) - int(low) if low.dtype.kind in "ui" else float(high) - float(low)
        is_single = low.dtype.kind == "f" and low.dtype.itemsize <= 4
        is_exact = (
            is_single
            or step <= 1
            and all(float(np.float32(value)) == float(value) for value in (low, high))
        )
        if not is_exact and 0 < span < MIN_STEPS * step:
            raise InputError(
                f"the image has values from {low} to {high}: computed in single precision, it would have "
                f"{int(span / step) + 1} different values",
                f"subtract {low} from all voxels first, in Python: volume.with_array(volume.array - {low})",
            )


class Places:
    """Number of some voxels, and the first of them."""

    def __init__(self) -> None:
        self.count = 0
        self._first = (0, 0, 0)

    @classmethod
    def of(cls, bad: NDArray[np.bool_]) -> Places:
        """Check a whole image."""
        places = cls()
        places.add(bad)
        return places

    def add(self, bad: NDArray[np.bool_], corner: Corner = (0, 0, 0)) -> None:
        """Count voxels of a box from voxel ``corner`` on."""
        if not self.count and bad.any():
            z, y, x = (
                int(i) + c
                for i, c in zip(np.unravel_index(int(bad.argmax()), bad.shape), corner, strict=True)
            )
            self._first = z, y, x
        self.count += int(bad.sum())

    @property
    def at(self) -> str:
        """The first place, as --at of accelsurf look takes it."""
        z, y, x = self._first
        return f"{x},{y},{z}vox"

    def __str__(self) -> str:
        """'3 voxels are', with the first place in the order people type it, x first."""
        z, y, x = self._first
        return f"{self.count} {'voxel is' if self.count == 1 else 'voxels are'} (first at index x={x}, y={y}, z={z})"


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
