"""Slice, channel and time point of each page of a TIFF, and the size of a voxel: OME, ImageJ, tifffile, plain.

tifffile has these readers, too: where a description contradicts the pages, they take another arrangement in silence,
and files of a set that are missing are zeros. OME-XML with a document type is refused: a few lines of entities could
unfold to any length.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import tifffile
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.io.headers import TIMES_KEY, FrameTimes
from accelsurf.settings import budgets
from accelsurf.settings.wording import mm_of, seconds_of, unit_name

#: The description of the first page of a file of ImageJ begins so.
IMAGEJ = "ImageJ="
#: Beginnings of texts that describe the pages.
_MARKS = (IMAGEJ, "<?xml", "<OME", '{"shape": [')
#: Tags of the description, the numbers of pixels along y and x in a unit, and this unit.
_DESCRIPTION = 270
_Y_RESOLUTION = 283
_X_RESOLUTION = 282
_RESOLUTION_UNIT = 296
#: Centimetre, as unit of the resolution.
_CM = 3
#: Letters of tifffile for an axis of slices.
_SLICES = {"I": "Z", "Q": "Z"}
_ONE_MM = (1.0, 1.0, 1.0)


class TiffLengths(NamedTuple):
    """Lengths that a TIFF states.

    Attributes
    ----------
    spacing : tuple of float
        (z, y, x) in mm; 1 where it is not said.
    unit : str
        "nm", "um" or "mm", as the file gives lengths; empty where it gives none.
    is_depth_known : bool
        Whether the distance of the slices is said.
    reason : str
        Entries of the file on lengths that are not known, or not used as they are; empty where all is said.
    """

    spacing: tuple[float, float, float] = _ONE_MM
    unit: str = ""
    is_depth_known: bool = False
    reason: str = ""


class Description(NamedTuple):
    """Description of a page.

    Attributes
    ----------
    text : str
    is_ended : bool
        Whether its end mark is there.
    """

    text: str
    is_ended: bool


@dataclass(frozen=True, eq=False)
class TiffStack:
    """Arrangement of the pages of a TIFF in an image.

    Attributes
    ----------
    pages : ndarray (time points, channels, slices) of int64
        The number of the page in its file.
    lengths : TiffLengths
    seconds : float or None
        From one time point to the next.
    files : tuple of str
        Names of the files, relative to the folder; empty for the file itself, which is the first.
    file_numbers : ndarray (time points, channels, slices) of int64
        Which of them has the page.
    counts_all : bool
        Whether the numbers of pages count thumbnails, too.
    times : FrameTimes or None
        Where each time point has its own.
    """

    pages: NDArray[np.int64]
    lengths: TiffLengths
    seconds: float | None = None
    files: tuple[str, ...] = ("",)
    file_numbers: NDArray[np.int64] | None = None
    counts_all: bool = False
    times: FrameTimes | None = None

    @property
    def frame_times(self) -> FrameTimes | None:
        """When the time points are; None where it is not said."""
        if self.times is None and self.seconds is not None:
            return FrameTimes.regular(self.time_points, self.seconds)
        return self.times

    @property
    def time_points(self) -> int:
        """Number of time points."""
        return int(self.pages.shape[0])

    @property
    def channels(self) -> int:
        """Number of pages for a slice at a time point."""
        return int(self.pages.shape[1])


def number(text: str, name: str) -> float:
    """A number whose decimal mark may be a comma.

    Parameters
    ----------
    text : str
    name : str
        Name of the number, for the message.

    Raises
    ------
    InputError
        When it is no number.

    Examples
    --------
    >>> number(" 1,5", "spacing")
    1.5
    """
    try:
        return float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)
    except ValueError:
        raise InputError(
            f"the TIFF says {name} = {text.strip()[:40]!r}, a number expected",
            "export it again, or correct its header",
        ) from None


def length(value: float, mm: float) -> float:
    """A length in mm, by its number and the millimetres of its unit; 0 where either is not known.

    Examples
    --------
    >>> length(-1.5, 1e-3), length(0.0, 1.0), length(float("nan"), 1.0)
    (0.0015, 0.0, 0.0)
    """
    found = abs(value) * mm
    return found if math.isfinite(found) else 0.0


def description_of(page: tifffile.TiffPage) -> Description:
    """The description of a page in UTF-8, else in Latin-1, as ImageJ writes it: its micro sign is one byte."""
    tag = page.tags.get(_DESCRIPTION)
    if tag is None:
        return Description("", True)
    page.parent.filehandle.seek(tag.valueoffset)
    text, mark, _ = page.parent.filehandle.read(tag.count).partition(b"\0")
    try:
        return Description(text.decode(), bool(mark))
    except UnicodeDecodeError:
        return Description(text.decode("latin-1"), bool(mark))


def stack_of(page: tifffile.TiffPage, pages: int, samples: int) -> TiffStack:
    """Read the arrangement of the pages from the first of them.

    Parameters
    ----------
    page : tifffile.TiffPage
    pages : int
        How many there are, without thumbnails.
    samples : int
        Values of a pixel: they may be channels.

    Raises
    ------
    InputError
        When it contradicts the pages; ValueError and others of damaged numbers.
    """
    text, is_ended = description_of(page)
    if not is_ended and any(text.startswith(mark) or mark.startswith(text) for mark in _MARKS):
        raise InputError(
            "the description of the TIFF, which says what its pages are, has no end mark",
            TRUNCATED_HINT,
        )
    if "<OME" in text[:4096] or "OME>" in text[-16:]:
        return _ome_stack(text, pages, samples)
    if text.startswith(IMAGEJ):
        return _imagej_stack(text, page, pages)
    # Inches are of a screen or a printer, not of the object.
    mm = 10.0 if page.tags.valueof(_RESOLUTION_UNIT, 2) == _CM else 0.0
    y, x = (_pixel_length(page, tag) * mm for tag in (_Y_RESOLUTION, _X_RESOLUTION))
    return TiffStack(_table(_tifffile_axes(text, pages, samples)), _lengths(0.0, y, x, "mm"))


def _table(sizes: dict[str, int]) -> NDArray[np.int64]:
    """Numbers of the pages by (t, c, z), of the lengths of axes with the slowest first."""
    order = [*sizes, *(axis for axis in "TCZ" if axis not in sizes)]
    shape = [sizes.get(axis, 1) for axis in order]
    numbers = np.arange(math.prod(shape), dtype=np.int64).reshape(shape)
    return np.ascontiguousarray(numbers.transpose([order.index(axis) for axis in "TCZ"]))


def _tifffile_axes(text: str, pages: int, samples: int) -> dict[str, int]:
    """The lengths of the axes that tifffile has written, slowest first; else all pages are slices."""
    plain = {"Z": pages}
    try:
        said = json.loads(text)
        axes = list(zip(said["axes"], map(int, said["shape"]), strict=True))
    except (ValueError, LookupError, TypeError, RecursionError):
        return plain
    axes = [(_SLICES.get(axis, axis), n) for axis, n in axes if axis not in "YXS" and n > 1]
    if samples > 1 and math.prod(n for _, n in axes) != pages:
        axes = [axis for axis in axes if axis != ("C", samples)]
    sizes = dict(axes)
    fits = math.prod(sizes.values()) == pages and len(sizes) == len(axes)
    return sizes if fits and set(sizes) <= set("TCZ") else plain


def _pixel_length(page: tifffile.TiffPage, tag: int) -> float:
    """Size of a pixel in the unit of the resolution; 0 where it is not said."""
    pixels, units = page.tags.valueof(tag, (0, 0))
    return units / pixels if pixels else 0.0


def _lengths(z: float, y: float, x: float, unit: str, reason: str = "") -> TiffLengths:
    """Lengths by sizes of a voxel in mm, which are 0 where they are not known.

    Where the size of a pixel is not known, a distance of the slices alone is of no use.
    """
    if not (x and y):
        return TiffLengths(reason=reason)
    return TiffLengths((z or 1.0, y, x), unit, z > 0, reason)


def _imagej_stack(text: str, page: tifffile.TiffPage, pages: int) -> TiffStack:
    """Read the lines that ImageJ writes; the channel runs fastest, then the slice."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line)
    fields = {key.strip(): value.strip() for key, value in pairs}
    images = int(fields.get("images", pages))
    # A stack beyond 4 GiB has one directory, and the other pages follow as they are.
    count = images if pages == 1 and images > 1 else pages
    channels, frames = int(fields.get("channels", 1)), int(fields.get("frames", 1))
    if images > count or channels < 1 or frames < 1:
        raise InputError(
            f"the TIFF announces {fields['images']} images and has {pages} page{'s' if pages > 1 else ''}",
            hint="save the stack with a page for each slice",
        )
    is_stack = "slices" not in fields or channels * frames == 1
    slices = count // (channels * frames) if is_stack else int(fields["slices"])
    if slices < 1 or channels * frames * slices != count:
        raise InputError(
            f"the TIFF announces {channels} channels, {slices} slices and {frames} frames, and has {count} pages",
            hint="save the stack again with ImageJ",
        )
    budgets.TIFF_PLANES.check(count)
    return TiffStack(
        _table({"T": frames, "Z": slices, "C": channels}),
        _imagej_lengths(fields, page),
        _seconds(fields.get("finterval", "0"), "finterval", fields.get("tunit", "s")),
    )


def _seconds(text: str, name: str, unit: str) -> float | None:
    """A step of time; None where it is none."""
    seconds = number(text, name) * seconds_of(unit)
    return seconds if math.isfinite(seconds) and seconds > 0 else None


def _imagej_lengths(fields: dict[str, str], page: tifffile.TiffPage) -> TiffLengths:
    """Read the lengths of ImageJ.

    As in ImageJ, y and z have the unit of x where they have none, and a negative distance is that of slices in the
    other order. Micro-Manager gives the unit um and pixels per cm.
    """
    unit = fields.get("unit", "")
    z_mm, y_mm, x_mm = (mm_of(fields.get(key) or unit) for key in ("zunit", "yunit", "unit"))
    is_cm = page.tags.valueof(_RESOLUTION_UNIT, 2) == _CM
    if is_cm and not unit:
        y_mm, x_mm = 10.0, 10.0
    um_per_unit = 1e4 if is_cm and unit == "um" else 1.0
    y, x = (um_per_unit * _pixel_length(page, tag) for tag in (_Y_RESOLUTION, _X_RESOLUTION))
    z = number(fields.get("spacing", "0"), "spacing")
    vain = [key for key in ("unit", "yunit", "zunit") if fields.get(key) and not mm_of(fields[key])]
    vain += ["spacing"] if "spacing" in fields and not length(z, 1.0) else []
    reason = ", ".join(f"{key}={fields[key][:40]}" for key in vain)
    return _lengths(length(z, z_mm), length(y, y_mm), length(x, x_mm), unit_name(x_mm), reason)


def _ome_stack(text: str, pages: int, samples: int) -> TiffStack:
    """Read the XML of an OME-TIFF, in which the unit is the micrometre unless another is named."""
    if "<!DOCTYPE" in text:
        raise InputError(
            "the OME-XML of the TIFF has a document type, not expected", "save the image again"
        )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the OME-XML of the TIFF is damaged ({error})", TRUNCATED_HINT) from None
    if (other := root.find("{*}BinaryOnly")) is not None:
        name = other.get("MetadataFile", "another file")[:80]
        raise InputError(
            f"this file of an OME-TIFF has voxels only, {name} says what they are", "give that file"
        )
    images = root.findall(".//{*}Pixels")
    if len(images) != 1:
        raise InputError(
            f"an OME-TIFF of {len(images)} images given, one expected", "save one of them by itself"
        )
    pixels = images[0]
    times, channels = (int(pixels.get(f"Size{axis}", 1)) for axis in "TC")
    if samples > 1 and channels % samples == 0:
        channels //= samples
    slices = int(pixels.get("SizeZ", pages // max(times * channels, 1)))
    if min(times, channels, slices) < 1:
        raise ValueError("a size is none")
    budgets.TIFF_PLANES.check(times * channels * slices)
    sizes = {"T": times, "C": channels, "Z": slices}
    places = _assigned(pixels, sizes, root.get("UUID", ""))
    if (places.pages < 0).any():
        t, c, z = (int(n) for n in np.argwhere(places.pages < 0)[0])
        raise InputError(
            f"the OME-TIFF has no page for slice {z} of channel {c} at time point {t}",
            "export it again, as a whole",
        )
    if len(places.names) == 1 and places.pages.max() >= pages:
        raise InputError(
            f"the OME-TIFF announces page {int(places.pages.max()) + 1}, and has {pages}",
            "export it again, as a whole",
        )
    unit = pixels.get("TimeIncrementUnit", "s")
    return TiffStack(
        places.pages,
        _ome_lengths(pixels),
        _seconds(pixels.get("TimeIncrement", "0"), "TimeIncrement", unit),
        places.names,
        places.files,
        True,
        _ome_times(root, pixels, times),
    )


def _ome_times(
    root: ElementTree.Element, pixels: ElementTree.Element, count: int
) -> FrameTimes | None:
    """Read the times of a number of time points, where each has a time, and they rise."""
    for note in root.iterfind(".//{*}CommentAnnotation"):
        if note.get("Namespace") == TIMES_KEY and (text := "".join(note.itertext())).strip():
            return FrameTimes.from_text(text, count)
    delays: dict[int, float] = {}  # seconds of the first plane of each time point
    for plane in pixels.iterfind("{*}Plane"):
        if "DeltaT" in plane.attrib:
            unit = seconds_of(plane.get("DeltaTUnit", "s")) or math.nan
            point = int(plane.get("TheT", 0))
            delays[point] = min(float(plane.attrib["DeltaT"]) * unit, delays.get(point, math.inf))
    values = tuple(delays.get(point, math.nan) for point in range(count))
    rising = all(math.isfinite(b) and a < b for a, b in zip(values, values[1:], strict=False))
    return FrameTimes(values, "s") if count > 1 and math.isfinite(values[0]) and rising else None


class _Places(NamedTuple):
    """Places of the pages of an OME-TIFF: names of files, and the number of file and page by (t, c, z)."""

    names: tuple[str, ...]
    files: NDArray[np.int64]
    pages: NDArray[np.int64]


def _assigned(pixels: ElementTree.Element, sizes: dict[str, int], uuid_here: str) -> _Places:
    """Places of the pages by the TiffData elements; of a page that none has, the number is -1."""
    order = pixels.get("DimensionOrder", "XYZCT")[2:]
    if sorted(order) != ["C", "T", "Z"]:
        raise ValueError(f"the order of axes is {order[:8]}")
    first, second, third = (sizes[axis] for axis in order)
    steps = {order[0]: 1, order[1]: first, order[2]: first * second}
    files, pages = (np.full(first * second * third, -1, np.int64) for _ in range(2))
    names = {"": 0}
    for part in pixels.findall("{*}TiffData") or [ElementTree.Element("TiffData")]:
        uuid = part.find("{*}UUID")
        name = "" if uuid is None else uuid.get("FileName", "")
        if uuid is not None and uuid_here and (uuid.text or "").strip() == uuid_here:
            name = ""
        begin = sum(int(part.get(f"First{axis}", 0)) * steps[axis] for axis in "TCZ")
        page = int(part.get("IFD", 0))
        count = int(part.get("PlaneCount", 1 if "IFD" in part.attrib else len(pages) - begin))
        end = begin + count
        if min(begin, count - 1, page) < 0 or end > len(pages) or (pages[begin:end] >= 0).any():
            raise InputError(
                "the TiffData of the OME-TIFF go beyond its sizes, or overlap", "export it again"
            )
        files[begin:end] = names.setdefault(name, len(names))
        pages[begin:end] = np.arange(page, page + count)
    slowest_first = order[::-1]
    axes = [slowest_first.index(axis) for axis in "TCZ"]
    shape = (third, second, first)
    return _Places(
        tuple(names), files.reshape(shape).transpose(axes), pages.reshape(shape).transpose(axes)
    )


def _ome_lengths(pixels: ElementTree.Element) -> TiffLengths:
    """Read the lengths of an OME-TIFF."""
    keys = [f"PhysicalSize{axis}" for axis in "ZYX"]
    units = [mm_of(pixels.get(f"{key}Unit", "um")) for key in keys]
    values = [number(pixels.get(key, "0"), key) for key in keys]
    wrong = [key for key, n in zip(keys, values, strict=True) if key in pixels.attrib and not n > 0]
    wrong += [f"{key}Unit" for key, mm in zip(keys, units, strict=True) if not mm]
    z, y, x = (length(value, mm) for value, mm in zip(values, units, strict=True))
    reason = ", ".join(f"{key}={pixels.attrib[key][:40]}" for key in wrong)
    return _lengths(z, y, x, unit_name(units[2]), reason)
