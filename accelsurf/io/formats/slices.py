"""A folder of slices, one TIFF or PNG for each, or those that a pattern names: slices/*.tif.

They are put in the order of the numbers in their names: 2 before 10. All have one size and one type of values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.formats.tiff import TiffImage
from accelsurf.io.headers import UNIT_KEY, WARNING_KEY, with_given_unit, with_warnings
from accelsurf.io.lazy_volume import LazyVolume, Opening, StackedVoxels, StoreLayout
from accelsurf.io.memory import check_memory
from accelsurf.settings import budgets
from accelsurf.settings.file_formats import ImageFormat
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_SUFFIXES = (".tif", ".tiff", ".png")
_LOSSY = (".jpg", ".jpeg")
_MAX_SHOWN = 8


@dataclass(frozen=True, eq=False)
class SliceFolder:
    """Claims of the files of a folder.

    Attributes
    ----------
    data : Path
        The folder or pattern.
    files : tuple of Path
        In the order of the slices.
    headers : tuple
        Claims of each file.
    form : ImageFormat
        Of the files.
    geometry : Geometry
    metadata : dict of str to str
    """

    data: Path
    files: tuple[Path, ...]
    headers: tuple[Any, ...]
    form: ImageFormat
    geometry: Geometry
    metadata: dict[str, str]


def fitting_names(path: Path, stores: bool = False) -> tuple[Path, list[str]]:
    """The folder of a path, and the names of the files in it, or of those that fit its pattern; without hidden ones.

    Parameters
    ----------
    path : Path
        A folder, or a folder and a pattern of names.
    stores : bool
        Whether folders that are images count too.

    Raises
    ------
    InputError
        When the folder does not exist, or a file is a JPEG.
    """
    folder, pattern = (path, "*") if path.is_dir() else (path.parent, path.name)
    if not folder.is_dir():
        raise InputError("there is no such folder", "check the path")
    names = [
        entry.name
        for entry in folder.iterdir()
        if fnmatchcase(entry.name, pattern)
        and not entry.name.startswith(".")
        and (entry.is_file() or (stores and headers.is_stored(entry)))
    ]
    if lossy := [name for name in names if name.lower().endswith(_LOSSY)]:
        raise InputError(
            f"{lossy[0]} is a JPEG, whose values are not those of the microscope or scanner",
            "export the images as TIFF or PNG",
        )
    return folder, names


def is_slices(folder: Path) -> bool:
    """Test if a folder holds slices."""
    return any(entry.suffix.lower() in (*_SUFFIXES, *_LOSSY) for entry in folder.iterdir())


def in_order(names: Sequence[str]) -> list[str]:
    """Names of files in the order of the numbers in them.

    Examples
    --------
    >>> in_order(["a10.tif", "a2.tif", "a1.tif"])
    ['a1.tif', 'a2.tif', 'a10.tif']
    """
    return sorted(names, key=lambda name: (_numbered(name), name))


def _numbered(name: str) -> list[tuple[int, str]]:
    """Texts and numbers of a name in turns, to be compared."""
    words = re.split(r"([0-9]+)", name)
    return [
        (int(word) if place % 2 else 0, "" if place % 2 else word)
        for place, word in enumerate(words)
    ]


def parse_slices(path: Path, options: ReadOptions = AS_IT_IS) -> SliceFolder:
    """Read the headers of all slices.

    Raises
    ------
    InputError
        When there is none, or they differ in kind or size.
    """
    files = _files(path)
    found = []
    for file in files:
        with naming(file):
            found.append(headers.parse_header(file))
    form = found[0][0]
    shapes = [_shape(header) for _, header in found]
    for file, shape in zip(files, shapes, strict=True):
        if shape != shapes[0] or shape[0] != 1:
            sizes = (" x ".join(map(str, lengths[::-1])) for lengths in (shape, shapes[0]))
            raise InputError(
                f"{file.name} has {' pixels, the first slice '.join(sizes)}: one size and one slice in each expected",
                "leave out the files that are none of the stack; give a pattern, as 'FOLDER/slice*.tif'",
            )
    first = found[0][1]
    notes, metadata = [_gaps([file.name for file in files])], {}
    spacing: tuple[float, ...]
    if options.spacing is not None:
        spacing = options.spacing[::-1]
    elif isinstance(first, TiffImage) and first.stack.lengths.is_depth_known:
        spacing = first.stack.lengths.spacing
    else:
        plane = first.stack.lengths.spacing[1:] if isinstance(first, TiffImage) else (1.0, 1.0)
        spacing = (1.0, *plane)
        text = " x ".join(f"{h:.6g}" for h in spacing[::-1])
        notes.append(
            f"the slices do not say how far apart they are: voxels of {text} mm are taken; give --spacing"
        )
    if isinstance(first, TiffImage) and UNIT_KEY in first.metadata:
        metadata[UNIT_KEY] = first.metadata[UNIT_KEY]
    metadata = with_given_unit(metadata, options)
    geometry = Geometry((len(files), *shapes[0][1:]), spacing)
    return SliceFolder(
        path,
        tuple(files),
        tuple(header for _, header in found),
        form,
        geometry,
        with_warnings(metadata, *notes),
    )


def _shape(header: Any) -> tuple[int, int, int]:
    shape: tuple[int, int, int] = (
        header.grids[0].shape if isinstance(header, TiffImage) else header.shape
    )
    return shape


def _files(path: Path) -> list[Path]:
    """The files of the slices, in order.

    Raises
    ------
    InputError
        When there are none, too many, or of several kinds.
    """
    folder, names = fitting_names(path)
    names = [name for name in names if name.lower().endswith(_SUFFIXES)]
    budgets.SLICES.check(len(names))
    if not names:
        raise InputError("no TIFF or PNG fits", "check the folder and the pattern")
    if len({name.lower().endswith(".png") for name in names}) > 1:
        raise InputError(
            "TIFF and PNG files are there, one kind expected", "give a pattern, as 'FOLDER/*.tif'"
        )
    return [folder / name for name in in_order(names)]


def changing_numbers(names: Sequence[str]) -> list[tuple[int, ...]]:
    """Numbers in names of files that are not the same in all: for each place in the names, one of each name.

    Examples
    --------
    >>> changing_numbers(["a1_z2", "a1_z10"]), changing_numbers(["a1", "b"])
    ([(2, 10)], [])
    """
    numbers = [[int(n) for n in re.findall(r"[0-9]{1,18}", name)] for name in names]
    if len({len(some) for some in numbers}) != 1:
        return []
    return [column for column in zip(*numbers, strict=True) if len(set(column)) > 1]


def shown_gaps(gaps: Sequence[int]) -> str:
    """The first numbers that no file has, for a message."""
    return ", ".join(map(str, gaps[:_MAX_SHOWN])) + (" ..." if len(gaps) > _MAX_SHOWN else "")


def _gaps(names: Sequence[str]) -> str:
    """Warning of gaps in the numbers of the names; empty where there is none."""
    columns = changing_numbers(names)
    if len(columns) != 1:
        return ""
    there = sorted(set(columns[0]))
    step = min(b - a for a, b in zip(there, there[1:], strict=False))
    gaps = [a + step for a, b in zip(there, there[1:], strict=False) if b - a != step]
    if not gaps:
        return ""
    return (
        f"slices are missing: the numbers of the files have gaps at {shown_gaps(gaps)}; the others are put side by "
        "side"
    )


def read_slices(path: Path, header: SliceFolder, available: int) -> Volume:
    """Read all slices.

    Raises
    ------
    InputError
        When one is damaged or of another type, or all are larger than the memory.
    """
    check_memory(
        header.geometry.size,
        header.headers[0].pixel_bytes if header.form.name == "png" else 4,
        available,
    )
    array: np.ndarray | None = None
    for z, (file, header_of_file) in enumerate(zip(header.files, header.headers, strict=True)):
        with naming(file):
            found = functions_of(header.form).read(file, header_of_file, available)
            if array is None:
                array, note = (
                    np.empty(header.geometry.shape, found.array.dtype),
                    found.metadata.get(WARNING_KEY, ""),
                )
            if found.array.dtype != array.dtype:
                raise InputError(
                    f"values of type {found.array.dtype}, those of the first slice are {array.dtype}",
                    "convert them",
                )
            array[z] = found.array[0]
    assert array is not None
    colours = note if "colour" in note or "transparent" in note else ""
    return Volume(array, header.geometry, with_warnings(header.metadata, colours), path)


def open_slices(path: Path, header: SliceFolder, opening: Opening) -> LazyVolume:
    """Open slices in TIFF, to be read box by box.

    Raises
    ------
    InputError
        When they are PNG or have colours.
    """
    open_form = functions_of(header.form).open
    if open_form is None:
        raise InputError(
            "slices in PNG are packed as a whole", "convert them to one OME-Zarr or to TIFF"
        )
    slabs = []
    for file, header_of_file in zip(header.files, header.headers, strict=True):
        with naming(file):
            slabs.append(
                open_form(file, header_of_file, Opening(cache_bytes=opening.cache_bytes)).voxels
            )
    layout = StoreLayout((header.geometry,), (1, *header.geometry.shape[1:]))
    voxels = StackedVoxels(slabs, [1] * len(slabs))
    return LazyVolume(voxels, header.geometry, dict(header.metadata), path, layout)
