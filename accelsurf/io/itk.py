"""SimpleITK's readers and writers, and its grids. What its libraries print is no line beside ours but a refusal.

libtiff, libpng and others print to standard error and go on, with values that may be wrong.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from threading import Lock, Thread
from typing import IO, Any, TypeVar

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

#: ITK's warnings are switched off for all threads: one at a time does so.
_LISTENING = Lock()
#: How lines of libraries begin or end, where lines of other threads are among them.
_LIBRARY_LINE = re.compile(
    r"libpng (warning|error): |(?!(error|warning|hint|note): )[^:]*: (Warning, |Error|.*\.$)"
    r"|ITK|Meta|M_|\*\* |(Warning|Error|Debug): In |gdcm|Corrupt|Unsupported|Premature"
)
_MAX_PRINTED = 1 << 16  # bytes that are heeded
_CLONE_FILES = 0x400
_T = TypeVar("_T")


def open_reader(path: Path, itk_name: str) -> sitk.ImageFileReader:
    """A reader of one format that has read the header of a file.

    Parameters
    ----------
    path : Path
        The file.
    itk_name : str
        The format, as ITK names the class that reads it.
    """
    reader = _reader(path, itk_name)
    listened(reader.ReadImageInformation)
    return reader


def _reader(path: Path, itk_name: str) -> sitk.ImageFileReader:
    """A reader of one format that has read nothing yet."""
    reader = sitk.ImageFileReader()
    reader.SetImageIO(itk_name)
    reader.SetFileName(str(path))
    return reader


def execute(reader: sitk.ImageFileReader) -> sitk.Image:
    """Read the voxels; a fourth axis of one is dropped."""
    image = listened(reader.Execute)
    return image[:, :, :, 0] if image.GetDimension() == 4 and image.GetSize()[3] == 1 else image


def array_of(path: Path, itk_name: str) -> NDArray[Any]:
    """The values of a file, (z, y, x), or with colours along a fourth axis."""
    return np.asarray(sitk.GetArrayFromImage(execute(_reader(path, itk_name))))


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
    # Its libraries print about a full disk and go on: what they wrote is read back, and told in one line.
    listened(lambda: writer.Execute(image), refuses=False)


def voxel_type(reader: sitk.ImageFileReader) -> np.dtype[Any]:
    """Type of a number in the array that a reader will give."""
    dtype: np.dtype[Any] = sitk.GetArrayFromImage(sitk.Image(1, 1, reader.GetPixelIDValue())).dtype
    return dtype


def geometry_of(image: sitk.Image | sitk.ImageFileReader) -> Geometry:
    """The grid of an image or of a header, by its first three axes."""
    axes = image.GetDimension()
    direction = np.array(image.GetDirection()).reshape(axes, axes)[:3, :3]
    return Geometry(
        image.GetSize()[2::-1], image.GetSpacing()[2::-1], image.GetOrigin()[:3], direction
    )


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
    return Volume(sitk.GetArrayFromImage(image), geometry_of(image))


def check_kind(reader: sitk.ImageFileReader, count: int = 1) -> None:
    """Refuse by name what is not a 3D image of real numbers (NIfTI was refused from its raw header already).

    Parameters
    ----------
    reader : sitk.ImageFileReader
    count : int
        How many components or volumes are expected.

    Raises
    ------
    InputError
        With the kind of image that it is.
    """
    size, components = reader.GetSize(), reader.GetNumberOfComponents()
    text = " x ".join(map(str, size))
    pixel = sitk.GetPixelIDValueAsString(reader.GetPixelIDValue())
    if "complex" in pixel:
        raise InputError(
            "a complex image given, one real number per voxel expected",
            hint="take the magnitude first",
        )
    volumes = size[3] if len(size) == 4 else 1
    if components > 1 and components * volumes != count:
        kind = (
            "colour (RGB) or vector" if components in (3, 4) and "unsigned" in pixel else "vector"
        )
        raise InputError(
            f"a {kind} image ({text}, {components} components per voxel) given, one number per voxel expected",
            hint="say which channel (--channel-index N), or extract one, or the magnitude, first",
        )
    if len(size) < 3:
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected",
            hint="add a slice axis of size 1, or use Volume.from_array in Python",
        )
    if len(size) > 4 or components * volumes != count:
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected",
            hint="extract one time point or channel first",
        )


def listened(work: Callable[[], _T], refuses: bool = True) -> _T:
    """Return what a call of ITK returns, without what its libraries print.

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
    with _LISTENING, tempfile.TemporaryFile() as printed:
        shown = sitk.ProcessObject.GetGlobalWarningDisplay()
        sitk.ProcessObject.SetGlobalWarningDisplay(False)
        try:
            future, lines = (
                _apart(work, printed) if sys.platform == "linux" else _among_others(work, printed)
            )
        finally:
            sitk.ProcessObject.SetGlobalWarningDisplay(shown)
    failure = future.exception()
    if lines and refuses and (failure is None or isinstance(failure, RuntimeError)):
        raise InputError(
            f"the library that reads it says: {lines[0]}",
            "the file is damaged: copy or export it again",
        ) from failure
    return future.result()


def _apart(work: Callable[[], _T], printed: IO[bytes]) -> tuple[Future[_T], list[str]]:
    """Do work in a thread that has a standard error of its own; return what came of it, and the lines.

    Linux gives a thread its own table of open files. Where a container forbids it, as elsewhere, the lines of all
    threads are taken.
    """
    future: Future[_T] = Future()

    def run() -> None:
        if _take_own_files():
            os.dup2(printed.fileno(), 2)
            _finish(future, work)

    thread = Thread(target=run)
    thread.start()
    thread.join()
    return (future, _lines(printed)) if future.done() else _among_others(work, printed)


def _finish(future: Future[_T], work: Callable[[], _T]) -> None:
    """Do work, and keep what it returns or raises."""
    try:
        future.set_result(work())
    except Exception as error:
        future.set_exception(error)


def _take_own_files() -> bool:
    """Give this thread a table of open files of its own; whether that was allowed."""
    return ctypes.CDLL(None).unshare(_CLONE_FILES) == 0


def _among_others(work: Callable[[], _T], printed: IO[bytes]) -> tuple[Future[_T], list[str]]:
    """Work as `_apart`, with the standard error of the process: lines of no library are written to it afterwards."""
    future: Future[_T] = Future()
    before = _standard_error()
    os.dup2(printed.fileno(), 2)
    try:
        _finish(future, work)
    finally:
        os.dup2(before, 2)
        os.close(before)
        lines = _lines(printed)
        if others := [line for line in lines if not _LIBRARY_LINE.match(line)]:
            os.write(2, "".join(f"{line}\n" for line in others).encode())
    return future, [line for line in lines if _LIBRARY_LINE.match(line)]


def _standard_error() -> int:
    """A second handle of standard error; where it is closed, nothing that is opened later is taken for it."""
    try:
        return os.dup(2)
    except OSError:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 2)
        if null != 2:
            os.close(null)
        return os.dup(2)


def _lines(printed: IO[bytes]) -> list[str]:
    """Read the lines that were printed."""
    printed.seek(0)
    return [
        line.strip()
        for line in printed.read(_MAX_PRINTED).decode("utf-8", "replace").splitlines()
        if line.strip()
    ]
