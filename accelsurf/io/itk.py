"""SimpleITK's reader and writers, and its images. A line of its libraries becomes a refusal, no line beside ours.

libtiff, libpng and others print to standard error and go on, with values that may be wrong.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Lock
from typing import IO, Any, TypeVar, cast

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

#: Standard error and ITK's warnings belong to all threads: one at a time takes them.
_LISTENING = Lock()
#: How lines of libraries begin or end, where lines of other threads are among them.
_LIBRARY_LINE = re.compile(
    r"libpng (warning|error): |(?!(error|warning|hint|note): )[^:]*: (Warning, |Error|.*\.$)"
    r"|ITK|Meta|M_|\*\* |(Warning|Error|Debug): In |gdcm|Corrupt|Unsupported|Premature|Invalid marker|Not a JPEG"
)
_MAX_PRINTED = 1 << 16  # bytes that are heeded
_T = TypeVar("_T")


def array_of(path: Path, itk_name: str) -> NDArray[Any]:
    """The values of a file, (z, y, x), or with colours along a fourth axis.

    Parameters
    ----------
    path : Path
        The file.
    itk_name : str
        The format, as ITK names the class that reads it.
    """
    reader = sitk.ImageFileReader()
    reader.SetImageIO(itk_name)
    reader.SetFileName(str(path))
    return np.asarray(sitk.GetArrayFromImage(listened(reader.Execute)))


def save(
    volume: Volume, path: Path, itk_name: str, compress: bool, keys: Mapping[str, str] | None = None
) -> None:
    """Write a volume in one format.

    Parameters
    ----------
    volume : Volume
        Of a type that the format knows.
    path : Path
        The file.
    itk_name : str
        The format, as ITK names the class that writes it.
    compress : bool
        Whether the voxels are packed.
    keys : mapping of str to str, optional
        Further entries of the header.
    """
    image = sitk.GetImageFromArray(volume.array)
    image.SetSpacing(volume.geometry.spacing_xyz)
    image.SetOrigin(volume.geometry.origin)
    image.SetDirection(volume.geometry.direction.ravel().tolist())
    for key, value in (keys or {}).items():
        image.SetMetaData(key, value)
    writer = sitk.ImageFileWriter()
    writer.SetImageIO(itk_name)
    writer.SetFileName(str(path))
    writer.SetUseCompression(compress)
    # Its libraries print about a full disk and go on: the file is read back, and the fault told in one line.
    listened(lambda: writer.Execute(image), refuses=False)


def volume_of(image: sitk.Image) -> Volume:
    """Return an image of SimpleITK as a volume; a 2D one is one slice.

    Raises
    ------
    InputError
        When it has several values per voxel, or several volumes.
    """
    if image.GetDimension() == 2:
        image = sitk.JoinSeries(image)
    elif image.GetDimension() == 4 and image.GetSize()[3] == 1:
        image = image[:, :, :, 0]
    axes, values = image.GetDimension(), image.GetNumberOfComponentsPerPixel()
    if axes != 3 or values > 1:
        raise InputError(
            f"an image of SimpleITK with {axes} axes and {values} values per voxel given, 3 and 1 expected",
            "take one time point, or one channel: sitk.VectorIndexSelectionCast",
        )
    spacing, direction = image.GetSpacing()[::-1], np.array(image.GetDirection()).reshape(3, 3)
    grid = Geometry(image.GetSize()[::-1], spacing, image.GetOrigin(), direction)
    return Volume(sitk.GetArrayFromImage(image), grid)


def listened(work: Callable[[], _T], refuses: bool = True) -> _T:
    """Return the result of a call of ITK, without the lines that its libraries print.

    ITK's own warnings are switched off: accelsurf checks the file and reports a problem in one line.

    Parameters
    ----------
    work : callable
    refuses : bool
        Whether a line of a library is an error.

    Raises
    ------
    InputError
        With that line, also in place of an error of ITK, which says less.
    """
    result, failure = None, None
    with _LISTENING:
        before, shown = _standard_error(), sitk.ProcessObject.GetGlobalWarningDisplay()
        with tempfile.TemporaryFile() as printed:
            os.dup2(printed.fileno(), 2)
            sitk.ProcessObject.SetGlobalWarningDisplay(False)
            try:
                result = work()
            except RuntimeError as error:
                failure = error
            finally:
                sitk.ProcessObject.SetGlobalWarningDisplay(shown)
                os.dup2(before, 2)
                os.close(before)
                lines = _library_lines(printed)
    if lines and refuses:
        raise InputError(
            f"the library that reads it says: {lines[0]}",
            "the file is damaged: copy or export it again",
        ) from failure
    if failure is not None:
        raise failure
    return cast(_T, result)


def _standard_error() -> int:
    """A second handle of standard error; where it is closed, nothing that is opened later is taken for it."""
    try:
        return os.dup(2)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        return os.dup(2)


def _library_lines(printed: IO[bytes]) -> list[str]:
    """The lines of libraries among the printed ones; the others, of other threads, are printed now."""
    printed.seek(0)
    text = printed.read(_MAX_PRINTED).decode("utf-8", "replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if others := [line for line in lines if not _LIBRARY_LINE.match(line)]:
        os.write(2, "".join(f"{line}\n" for line in others).encode())
    return [line for line in lines if _LIBRARY_LINE.match(line)]
