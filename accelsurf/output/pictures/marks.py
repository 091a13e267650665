"""Pictures that may be replaced unasked: those that ``look`` made and that nobody has changed since."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL.PngImagePlugin import PngImageFile, PngInfo

from accelsurf.output.pictures.movies import png_bytes

#: The text in a PNG with the digest of its pixels.
_KEY = "accelsurf look"
#: Bytes of a file at most that is looked into: a picture has less.
_MAX_BYTES = 1 << 26


def marked_png(pixels: NDArray[np.uint8]) -> bytes:
    """Return pixels (height, width, 3) as a PNG that says whose it is.

    Examples
    --------
    >>> marked_png(np.zeros((2, 3, 3), np.uint8))[1:4]
    b'PNG'
    """
    text = PngInfo()
    text.add_text(_KEY, _digest(pixels))
    return png_bytes(pixels, text)


def is_own_picture(path: Path) -> bool:
    """Return True if a file is a picture as `marked_png` made it: a copy that was drawn on, or cut, is somebody's."""
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > _MAX_BYTES:
            return False
        with PngImageFile(path) as image:
            said = image.info.get(_KEY)
            if (
                not isinstance(said, str)
                or image.mode != "RGB"
                or image.size[0] * image.size[1] > _MAX_BYTES
            ):
                return False
            return said == _digest(np.asarray(image))
    except (OSError, SyntaxError, ValueError, EOFError):  # no PNG, or a damaged one
        return False


def _digest(pixels: NDArray[np.uint8]) -> str:
    size = f"{pixels.shape}".encode()
    return hashlib.sha256(size + np.ascontiguousarray(pixels).tobytes()).hexdigest()
