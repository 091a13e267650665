"""TIFF images: stacks, hyperstacks of ImageJ, OME-TIFF also of several files, pyramids; one or more channels at a time.

The pages are found and checked here, before anything unpacks them (see `accelsurf.io.formats.tiff`).
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.channels import selected, single, to_grey
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels
from accelsurf.io.formats.tiff import (
    HEIGHT,
    SUB_PAGES,
    SUBFILE,
    WIDTH,
    Directories,
    Page,
    TiffHeader,
    header_of,
    read_directory,
    read_pages,
    samples_of,
)
from accelsurf.io.formats.tiff_pages import TiffPages
from accelsurf.io.formats.tiff_stack import TiffStack, stack_of
from accelsurf.io.headers import FRAME_KEY, UNIT_KEY, FrameTimes, with_given_unit, with_warnings
from accelsurf.io.lazy_volume import (
    LazyVolume,
    Opening,
    StackedVoxels,
    StoreLayout,
    VoxelSource,
    checked_level,
)
from accelsurf.io.memory import check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_MAX_LEVELS = 32
Spacing = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class TiffImage:
    """Claims of a TIFF.

    Attributes
    ----------
    data : Path
        The file.
    stack : TiffStack
        Which page is what; its numbers are those of the pages in ``parts``.
    parts : tuple of TiffHeader
        Of each file, the pages that are used, at the level that is read.
    samples : int
        Values of a pixel that are channels.
    grids : tuple of Geometry
        Of the levels, finest first.
    level : int
        Which of them is read.
    metadata : dict of str to str
        As in `Volume`.
    options : ReadOptions
        Which channel and time point is read.
    """

    data: Path
    stack: TiffStack
    parts: tuple[TiffHeader, ...]
    samples: int
    grids: tuple[Geometry, ...]
    level: int
    metadata: dict[str, str]
    options: ReadOptions

    @property
    def channels(self) -> int:
        """Number of them."""
        return self.stack.channels * self.samples

    @property
    def time_points(self) -> int:
        """Number of them."""
        return self.stack.time_points

    @property
    def frame_times(self) -> FrameTimes | None:
        """When they are; None where the file does not say it."""
        return self.stack.frame_times

    @property
    def geometry(self) -> Geometry:
        """The grid of the level that is read."""
        return self.grids[self.level]

    @property
    def values(self) -> int:
        """Number of values that are read, those of all channels together."""
        places = selected(self.channels, self.stack.time_points, self.options)
        return len(places) * math.prod(self.grids[self.level].shape)


def parse_tiff(path: Path, options: ReadOptions = AS_IT_IS) -> TiffImage:
    """Read the directories of a TIFF (also BigTIFF), and of the files that belong to it.

    Raises
    ------
    InputError
        When it is none, is damaged, its pages differ, or it is of a kind that is not read.
    UsageError
        When there is no such level.
    """
    try:
        with path.open("rb") as file:
            found = read_pages(file)
            pages = _without_thumbnails(found.pages)
            first = next(iter(pages.values()))
            samples = samples_of(first)
            stack = stack_of(first, len(pages), samples)
            sizes = _level_sizes(found, first)
            level = checked_level(options.level, sizes)
            spacing, metadata = _spacing(stack, options)
            grids = _grids(stack, sizes, spacing)
            found = found if stack.counts_all else found._replace(pages=pages)
            parts, stack = _headers_of_files(path, found, stack, level)
    except (LookupError, TypeError, ValueError, OverflowError, struct.error):
        raise InputError("the TIFF header is cut short or damaged", hint=TRUNCATED_HINT) from None
    return TiffImage(path, stack, parts, samples, grids, level, metadata, options)


def _without_thumbnails(all_pages: Mapping[int, Page]) -> dict[int, Page]:
    """The pages that are not smaller versions of others.

    Raises
    ------
    InputError
        When there is none, or one is called smaller and is not.
    """
    pages = {at: page for at, page in all_pages.items() if not page.get(SUBFILE, (0,))[0] & 1}
    if not pages:
        raise InputError("the TIFF holds no page", hint=TRUNCATED_HINT)
    first = next(iter(pages.values()))
    full = first[HEIGHT][0] * first[WIDTH][0]
    for number, (at, page) in enumerate(all_pages.items(), 1):
        if at not in pages and page[HEIGHT][0] * page[WIDTH][0] >= full:
            raise InputError(
                f"page {number} of the TIFF is marked as a reduced copy of another, but is as large as the first page",
                "save the stack again, without this mark (NewSubfileType)",
            )
    return pages


def _spacing(stack: TiffStack, options: ReadOptions) -> tuple[Spacing, dict[str, str]]:
    """The size of a voxel (z, y, x), mm, and what is said of the image."""
    notes = []
    is_stack = stack.pages.shape[2] > 1
    if options.spacing is not None:
        x, y, z = options.spacing
        said = (stack.spacing[0] if stack.is_depth_known else z, *stack.spacing[1:])
        if stack.unit and not np.allclose(said, (z, y, x), rtol=1e-4, atol=0):
            found = " x ".join(f"{h:.6g}" for h in said[::-1])
            notes.append(
                f"the voxels are {x:.6g} x {y:.6g} x {z:.6g} mm, as given; the file says {found} mm"
            )
        spacing = (z, y, x)
    else:
        spacing, reason = stack.spacing, f" ({stack.reason})" if stack.reason else ""
        if is_stack and not stack.unit:
            notes.append(
                f"the TIFF does not say how large a voxel is{reason}: 1 mm is taken; give --spacing"
            )
        elif is_stack and not stack.is_depth_known:
            notes.append(
                f"the TIFF does not say how far apart its slices are{reason}: 1 mm is taken; give --spacing"
            )
        elif reason:
            text = " x ".join(f"{h:.6g}" for h in spacing[::-1])
            notes.append(
                f"a length in the TIFF is negative, zero or unknown{reason}: voxels of {text} mm are taken; if that is "
                "wrong, give --spacing"
            )
    metadata = with_warnings({}, *notes)
    if stack.unit in ("nm", "um"):
        metadata[UNIT_KEY] = stack.unit
    metadata = with_given_unit(metadata, options)
    if stack.seconds is not None:
        metadata[FRAME_KEY] = repr(stack.seconds)
    return spacing, metadata


def _level_sizes(found: Directories, first: Page) -> list[tuple[int, int]]:
    """Rows and columns of the levels, by the directories below that of the first page."""
    sizes = [(int(first[HEIGHT][0]), int(first[WIDTH][0]))]
    below = first.get(SUB_PAGES, ())
    if len(below) > _MAX_LEVELS or min(sizes[0]) < 1:
        raise ValueError
    for at in below:
        page = read_directory(found.file, found.form, int(at)).page
        height, width = int(page[HEIGHT][0]), int(page[WIDTH][0])
        if not (0 < height <= sizes[-1][0] and 0 < width <= sizes[-1][1]):
            return sizes[:1]  # it is no pyramid
        sizes.append((height, width))
    return sizes


def _grids(
    stack: TiffStack, sizes: Sequence[tuple[int, int]], spacing: Spacing
) -> tuple[Geometry, ...]:
    """The grids of the levels, which all cover the same rectangle."""
    depth, (height, width) = stack.pages.shape[2], sizes[0]
    hz, hy, hx = spacing
    out = []
    for rows, columns in sizes:
        fy, fx = height / rows, width / columns
        origin = (0.5 * (fx - 1) * hx, 0.5 * (fy - 1) * hy, 0.0)
        out.append(Geometry((depth, rows, columns), (hz, hy * fy, hx * fx), origin))
    return tuple(out)


def _headers_of_files(
    path: Path, found: Directories, stack: TiffStack, level: int
) -> tuple[tuple[TiffHeader, ...], TiffStack]:
    """The headers of the files at a level, and the stack with numbers of their pages."""
    numbers = np.zeros_like(stack.pages) if stack.file_numbers is None else stack.file_numbers
    new_pages, new_files = np.empty_like(stack.pages), np.empty_like(stack.pages)
    parts: list[TiffHeader] = []
    for number, name in enumerate(stack.files):
        mine = numbers == number
        if not mine.any():
            continue
        wanted, places = np.unique(stack.pages[mine], return_inverse=True)
        if not number:
            repeats = (
                stack.pages.size
                if len(stack.files) == len(found.pages) == 1 and not stack.counts_all
                else 1
            )
            header = _file_header(path, found, wanted, level, repeats)
        else:
            other = path.parent / name
            headers.check_data_file(path, other)
            with other.open("rb") as file:
                header = _file_header(other, read_pages(file), wanted, level)
        new_pages[mine], new_files[mine] = places, len(parts)
        parts.append(header)
    if len({(part.shape[1:], part.stored) for part in parts}) > 1:
        raise InputError("the files of the OME-TIFF differ in size or type", "export them again")
    return tuple(parts), replace(stack, pages=new_pages, file_numbers=new_files)


def _file_header(
    path: Path, found: Directories, wanted: np.ndarray, level: int, repeats: int = 1
) -> TiffHeader:
    """The header of some pages of a file."""
    file, form, pages = found
    if repeats > 1:
        return header_of(path, form, pages, repeats)
    listed = list(pages.items())
    if wanted[-1] >= len(listed):
        raise InputError(
            f"page {int(wanted[-1]) + 1} of the TIFF is announced, and it has {len(listed)}",
            TRUNCATED_HINT,
        )
    some = dict(listed[page] for page in wanted.tolist())
    if level:
        below = [int(page[SUB_PAGES][level - 1]) for page in some.values()]
        some = {at: read_directory(file, form, at).page for at in below}
        if len(some) < len(below):
            raise InputError("pages of the TIFF share a directory of a level", TRUNCATED_HINT)
    return header_of(path, form, some)


def open_tiff(path: Path, header: TiffImage, opening: Opening) -> LazyVolume:
    """Open one channel of a grey image, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : TiffImage
        What it claims.
    opening : Opening
        How many bytes of unpacked pages are held.

    Raises
    ------
    InputError
        When it is a colour image, is cut short, or has several channels or time points of which none was named.
    """
    place = single(header.channels, header.stack.time_points, header.options)
    return _opened(path, header, *place, opening.cache_bytes)


def _opened(path: Path, image: TiffImage, t: int, c: int, cache_bytes: int) -> LazyVolume:
    """A channel at a time point."""
    geometry = image.grids[image.level]
    sample = c % image.samples if image.samples > 1 else None
    pages = image.stack.pages[t, c // image.samples].tolist()
    assert image.stack.file_numbers is not None
    numbers = image.stack.file_numbers[t, c // image.samples].tolist()
    sources, depths, is_packed = [], [], False
    for number, group in itertools.groupby(
        zip(numbers, pages, strict=True), key=lambda pair: pair[0]
    ):
        part = image.parts[number].select_pages([page for _, page in group], sample)
        sources.append(_source(part, cache_bytes))
        depths.append(part.shape[0])
        is_packed = is_packed or part.planes is None
    voxels: VoxelSource = sources[0] if len(sources) == 1 else StackedVoxels(sources, depths)
    chunks = (1, *geometry.shape[1:]) if is_packed else None
    layout = StoreLayout(image.grids, chunks, image.channels, image.stack.time_points, image.level)
    return LazyVolume(voxels, geometry, dict(image.metadata), path, layout)


def _source(header: TiffHeader, cache_bytes: int) -> VoxelSource:
    """The voxels of some pages of a file.

    Raises
    ------
    InputError
        When they have colours, or are cut short.
    """
    if header.stored is None:
        raise InputError(
            "a colour TIFF given: whether its three colours are the same everywhere is not known before all is read",
            "save it as grey",
        )
    if header.planes is not None:
        return RawVoxels(RawLayout(header.data, 0, header.stored, header.shape, header.planes))
    header.check_places()
    return TiffPages(header, cache_bytes)


def read_tiff(path: Path, header: TiffImage, available: int) -> Volume:
    """Read an image of one channel, or the channel that was asked for.

    Raises
    ------
    InputError
        When the file is incomplete, larger than the memory, or has several channels or time points.
    """
    place = single(header.channels, header.stack.time_points, header.options)
    return _read(path, header, place, available, 1)


def read_tiff_channels(path: Path, header: TiffImage, available: int) -> list[Volume]:
    """Read the channels of an image, or the one that was asked for.

    Raises
    ------
    InputError
        As `read_tiff`, and for more than `accelsurf.io.channels.MAX_CHANNELS` channels.
    """
    places = selected(header.channels, header.stack.time_points, header.options)
    return [_read(path, header, place, available, len(places)) for place in places]


def _read(
    path: Path, image: TiffImage, place: tuple[int, int], available: int, count: int
) -> Volume:
    """A channel at a time point, whole."""
    part, grid = image.parts[0], image.geometry
    check_memory(grid.shape[::-1], part.pixel_bytes * count, available)
    if part.stored is None and len(image.parts) == 1:
        t, c = place
        pages = TiffPages(part.select_pages(image.stack.pages[t, c].tolist()), 0)
        array, note = to_grey(pages.read(whole_box(grid.shape)))
        return Volume(array, grid, with_warnings(image.metadata, note), path)
    lazy = _opened(path, image, *place, 0)
    return Volume(lazy.voxels.read(whole_box(lazy.shape)), lazy.geometry, lazy.metadata, path)
