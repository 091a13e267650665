"""Colours to grey."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Parts of red, green and blue in the brightness of a colour (ITU-R BT.709)."""


def to_grey(array: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """One value per pixel from red, green, blue (and alpha), and what a person should know about that.

    Parameters
    ----------
    array : ndarray, shape (..., 3) or (..., 4)
        Colours of an unsigned type; the fourth is the opacity.

    Returns
    -------
    ndarray, str
        Where the three are equal everywhere, that value, unchanged; else the luminance as float32. The note is empty
        when nothing was decided.

    Examples
    --------
    >>> import numpy as np
    >>> to_grey(np.array([[[7, 7, 7], [9, 9, 9]]], dtype=np.uint8))
    (array([[7, 9]], dtype=uint8), '')
    """
    notes = []
    red, green, blue = array[..., 0], array[..., 1], array[..., 2]
    if np.array_equal(red, green) and np.array_equal(red, blue):
        grey = np.ascontiguousarray(red)
    else:
        grey = np.zeros(red.shape, np.float32)
        for part, channel in zip(LUMINANCE, (red, green, blue), strict=True):
            grey += np.float32(part) * channel
        notes.append(
            "a colour image: its luminance (0.2126 R + 0.7152 G + 0.0722 B) is used; "
            "extract a channel first if the object differs in colour more than in brightness"
        )
    if array.shape[-1] == 4 and (array[..., 3] != np.iinfo(array.dtype).max).any():
        notes.append("the image is transparent in places, which is ignored")
    return grey, "; ".join(notes)
