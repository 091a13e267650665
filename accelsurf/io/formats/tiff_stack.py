"""Slice, channel and time point of each page of a TIFF, and the size of a voxel: OME, ImageJ, tifffile, plain.

OME-XML with a document type is refused: a few lines of entities could unfold to any length.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.formats.png import TRUNCATED_HINT
from accelsurf.io.formats.tiff import DESCRIPTION, IMAGEJ, RES_UNIT, X_RES, Y_RES, Page
from accelsurf.io.headers import TIMES_KEY, FrameTimes
from accelsurf.settings import budgets
from accelsurf.settings.wording import mm_of, seconds_of, unit_name

_CM = 3  # as unit of the resolution
#: How texts begin that say what the pages are.
_MARKS = (IMAGEJ, "<?xml", "<OME", '{"shape": [')
_ONE_MM = (1.0, 1.0, 1.0)


def number(text: str, name: str) -> float:
    """A number whose decimal mark may be a comma.

    Parameters
    ----------
    text : str
    name : str
        What it is, for the message.

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


@dataclass(frozen=True, eq=False)
class TiffStack:
    """Arrangement of the pages of a TIFF in an image.

    Attributes
    ----------
    pages : ndarray (time points, channels, slices) of int64
        The number of the page in its file.
    files : tuple of str
        Names of the files, relative to the folder; empty for the file itself, which is the first.
    file_numbers : ndarray (time points, channels, slices) of int64
        Which of them has the page.
    spacing : tuple of float
        (z, y, x) in mm; 1 where it is not said.
    unit : str
        "nm", "um" or "mm", as the file gives lengths; empty where it gives none.
    is_depth_known : bool
        Whether the distance of the slices is said.
    seconds : float or None
        From one time point to the next.
    counts_all : bool
        Whether the numbers of pages count thumbnails, too.
    times : FrameTimes or None
        Where each time point has its own.
    reason : str
        What the file says of lengths that are not known, or in another way than is right; empty where all is said.
    """

    pages: NDArray[np.int64]
    spacing: tuple[float, float, float] = _ONE_MM
    unit: str = ""
    is_depth_known: bool = False
    seconds: float | None = None
    files: tuple[str, ...] = ("",)
    file_numbers: NDArray[np.int64] | None = None
    counts_all: bool = False
    times: FrameTimes | None = None
    reason: str = ""

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


def stack_of(page: Page, pages: int, samples: int) -> TiffStack:
    """Read the arrangement of the pages from the first of them.

    Parameters
    ----------
    page : Page
    pages : int
        How many there are, without thumbnails.
    samples : int
        Values of a pixel: they may be channels.

    Raises
    ------
    InputError
        When it says other than what is there; ValueError and others of damaged numbers.
    """
    text, is_ended = page.get(DESCRIPTION, ("", True))
    if not is_ended and any(text.startswith(mark) or mark.startswith(text) for mark in _MARKS):
        raise InputError(
            "the description of the TIFF, which says what its pages are, has no end mark",
            TRUNCATED_HINT,
        )
    if "<OME" in text[:4096] or "OME>" in text[-16:]:
        return _ome_stack(text, pages, samples)
    if text.startswith(IMAGEJ):
        return _imagej_stack(text, page, pages)
    sizes = _tifffile_axes(text, pages, samples)
    y, x = _resolution(page)
    mm = (
        10.0 if page.get(RES_UNIT, (2,))[0] == _CM else 0.0
    )  # inches are of a screen or a printer, not of the object
    return TiffStack(_table(sizes), *_said((0.0, y * mm, x * mm), "mm"))


def _table(sizes: Sequence[tuple[str, int]]) -> NDArray[np.int64]:
    """Numbers of the pages by (t, c, z), of axes with the slowest first."""
    found = dict(sizes)
    numbers = np.arange(math.prod(found.values()), dtype=np.int64).reshape(tuple(found.values()))
    missing = [axis for axis in "TCZ" if axis not in found]
    numbers = numbers.reshape(*numbers.shape, *[1] * len(missing))
    order = [*found, *missing]
    return np.ascontiguousarray(numbers.transpose([order.index(axis) for axis in "TCZ"]))


def _tifffile_axes(text: str, pages: int, samples: int) -> list[tuple[str, int]]:
    """The axes that tifffile has written, slowest first; else all pages are slices."""
    plain = [("Z", pages)]
    if not (text.startswith('{"shape": [') and '"axes"' in text and len(text) < 1 << 16):
        return plain
    try:
        said = json.loads(text)
        letters, shape = str(said["axes"]), [int(n) for n in said["shape"]]
    except (ValueError, LookupError, TypeError, RecursionError):
        return plain
    if len(letters) != len(shape):
        return plain
    names = {"I": "Z", "Q": "Z"}
    sizes = [
        (names.get(a, a), n)
        for a, n in zip(letters, shape, strict=True)
        if a not in "YXS" and n > 1
    ]
    if samples > 1 and math.prod(n for _, n in sizes) != pages:
        sizes = [(axis, n) for axis, n in sizes if (axis, n) != ("C", samples)]
    axes = [axis for axis, _ in sizes]
    if (
        math.prod(n for _, n in sizes) != pages
        or len(set(axes)) < len(axes)
        or not set(axes) <= set("TCZ")
    ):
        return plain
    return sizes


def _resolution(page: Page) -> tuple[float, float]:
    """Size of a pixel (y, x) in the unit of the resolution; 0 where it is not said."""
    (yn, yd), (xn, xd) = page.get(Y_RES, (0, 0)), page.get(X_RES, (0, 0))
    return yd / yn if yn else 0.0, xd / xn if xn else 0.0


def _said(
    sizes: tuple[float, float, float], unit: str
) -> tuple[tuple[float, float, float], str, bool]:
    """Spacing (z, y, x) in mm, its unit, and whether the distance of the slices is said, of lengths that may be 0.

    Where the size of a pixel is not known, a distance of the slices alone is of no use.
    """
    z, y, x = sizes
    return ((z or 1.0, y, x), unit, z > 0) if x and y else (_ONE_MM, "", False)


def _imagej_stack(text: str, page: Page, pages: int) -> TiffStack:
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
    slices = (
        count // (channels * frames)
        if "slices" not in fields or channels * frames == 1
        else int(fields["slices"])
    )
    if slices < 1 or channels * frames * slices != count:
        raise InputError(
            f"the TIFF announces {channels} channels, {slices} slices and {frames} frames, and has {count} pages",
            hint="save the stack again with ImageJ",
        )
    budgets.TIFF_PLANES.check(count)
    seconds = number(fields.get("finterval", "0"), "finterval") * seconds_of(
        fields.get("tunit", "s")
    )
    spacing, unit, is_depth_known, reason = _imagej_spacing(fields, page)
    return TiffStack(
        _table([("T", frames), ("Z", slices), ("C", channels)]),
        spacing,
        unit,
        is_depth_known,
        seconds if math.isfinite(seconds) and seconds > 0 else None,
        reason=reason,
    )


def _imagej_spacing(
    fields: dict[str, str], page: Page
) -> tuple[tuple[float, float, float], str, bool, str]:
    """Spacing (z, y, x) in mm, its unit, whether the distance of the slices is said, and what is said in vain.

    As in ImageJ, y and z have the unit of x where they have none, and a negative distance is that of slices in the
    other order. Micro-Manager gives the unit um and pixels per cm.
    """
    is_cm, unit = page.get(RES_UNIT, (2,))[0] == _CM, fields.get("unit", "")
    units = [mm_of(fields.get(key) or unit) for key in ("zunit", "yunit", "unit")]
    y, x = _resolution(page)
    if is_cm and unit == "um":
        y, x = 1e4 * y, 1e4 * x
    if is_cm and not unit:
        units = [units[0], 10.0, 10.0]
    sizes = (number(fields.get("spacing", "0"), "spacing"), y, x)
    z, y, x = (length(size, mm) for size, mm in zip(sizes, units, strict=True))
    vain = [key for key in ("unit", "yunit", "zunit") if fields.get(key) and not mm_of(fields[key])]
    vain += ["spacing"] if "spacing" in fields and not length(sizes[0], 1.0) else []
    reason = ", ".join(f"{key}={fields[key][:40]}" for key in vain)
    return *_said((z, y, x), unit_name(units[2])), reason


class _OmeReader:
    """Parser of the XML of an OME-TIFF, for its first image."""

    def __init__(self, text: str) -> None:
        if "<!DOCTYPE" in text:
            raise InputError(
                "the OME-XML of the TIFF has a document type, not expected", "save the image again"
            )
        try:
            self._root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise InputError(
                f"the OME-XML of the TIFF is damaged ({error})", TRUNCATED_HINT
            ) from None
        self.uuid = self._root.get("UUID", "")
        only = self._root.find("{*}BinaryOnly")
        self.binary_only = "" if only is None else only.get("MetadataFile", "another file")
        images = list(self._root.iterfind(".//{*}Pixels"))
        self.images, self._first = len(images), images[0] if images else self._root
        self.pixels = dict(self._first.attrib)

    def data(self) -> Iterator[tuple[dict[str, str], str, str]]:
        """Attributes of each TiffData, with the name and the UUID of its file, empty where it names none."""
        for part in self._first.iterfind("{*}TiffData"):
            uuid = part.find("{*}UUID")
            named = (
                ("", "") if uuid is None else (uuid.get("FileName", ""), (uuid.text or "").strip())
            )
            yield (part.attrib, *named)

    def times(self, count: int) -> FrameTimes | None:
        """Read the times of a number of time points, where each has its own time, and they rise."""
        for note in self._root.iterfind(".//{*}CommentAnnotation"):
            if note.get("Namespace") == TIMES_KEY and (text := "".join(note.itertext())).strip():
                return FrameTimes.from_text(text, count)
        delays: dict[int, float] = {}  # seconds of the first plane of each time point
        for plane in self._first.iterfind("{*}Plane"):
            if "DeltaT" in plane.attrib:
                seconds = float(plane.attrib["DeltaT"]) * (
                    seconds_of(plane.get("DeltaTUnit", "s")) or math.nan
                )
                point = int(plane.get("TheT", 0))
                delays[point] = min(seconds, delays.get(point, math.inf))
        values = tuple(delays.get(point, math.nan) for point in range(count))
        rising = all(math.isfinite(b) and a < b for a, b in zip(values, values[1:], strict=False))
        return (
            FrameTimes(values, "s") if count > 1 and math.isfinite(values[0]) and rising else None
        )


def _ome_stack(text: str, pages: int, samples: int) -> TiffStack:
    """Read the XML of an OME-TIFF, in which the unit is the micrometre unless another is named."""
    said = _OmeReader(text)
    if said.binary_only:
        raise InputError(
            f"this file of an OME-TIFF has voxels only, {said.binary_only[:80]} says what they are",
            "give that file",
        )
    if said.images != 1:
        raise InputError(
            f"an OME-TIFF of {said.images} images given, one expected", "save one of them by itself"
        )
    fields = said.pixels
    times, channels = (int(fields.get(f"Size{axis}", 1)) for axis in "TC")
    if samples > 1 and channels % samples == 0:
        channels //= samples
    slices = int(fields.get("SizeZ", pages // max(times * channels, 1)))
    if min(times, channels, slices) < 1:
        raise ValueError
    budgets.TIFF_PLANES.check(times * channels * slices)
    names, order = {"": 0}, fields.get("DimensionOrder", "XYZCT")[2:]
    if sorted(order) != ["C", "T", "Z"]:
        raise ValueError
    table = np.full((2, times, channels, slices), -1, np.int64)  # file, page
    _assign(said, table, order, names)
    if (table[1] < 0).any():
        t, c, z = (int(n) for n in np.argwhere(table[1] < 0)[0])
        raise InputError(
            f"the OME-TIFF has no page for slice {z} of channel {c} at time point {t}",
            "export it again, as a whole",
        )
    if len(names) == 1 and table[1].max() >= pages and pages:
        raise InputError(
            f"the OME-TIFF announces page {int(table[1].max()) + 1}, and has {pages}",
            "export it again, as a whole",
        )
    spacing, unit, known, reason = _ome_spacing(fields)
    second = seconds_of(fields.get("TimeIncrementUnit", "s"))
    seconds = number(fields.get("TimeIncrement", "0"), "TimeIncrement") * second
    return TiffStack(
        table[1],
        spacing,
        unit,
        known,
        seconds if math.isfinite(seconds) and seconds > 0 else None,
        tuple(names),
        table[0],
        True,
        said.times(times),
        reason,
    )


def _assign(said: _OmeReader, table: NDArray[np.int64], order: str, names: dict[str, int]) -> None:
    """Fill the table (file and page by t, c, z) by the TiffData elements, and number their files."""
    sizes = dict(zip("TCZ", table.shape[1:], strict=True))
    steps = {order[0]: 1, order[1]: sizes[order[0]], order[2]: sizes[order[0]] * sizes[order[1]]}
    planes = math.prod(sizes.values())
    flat = np.full((2, planes), -1, np.int64)  # in the order of the file
    for attributes, name, uuid in list(said.data()) or [({}, "", "")]:
        file = (
            names.setdefault(name, len(names)) if name and not (uuid and uuid == said.uuid) else 0
        )
        first = sum(int(attributes.get(f"First{axis}", 0)) * steps[axis] for axis in "TCZ")
        page = int(attributes.get("IFD", 0))
        count = int(attributes.get("PlaneCount", 1 if "IFD" in attributes else planes - first))
        if (
            first < 0
            or count < 1
            or page < 0
            or first + count > planes
            or (flat[1, first : first + count] >= 0).any()
        ):
            raise InputError(
                "the TiffData of the OME-TIFF go beyond its sizes, or overlap", "export it again"
            )
        flat[0, first : first + count] = file
        flat[1, first : first + count] = np.arange(page, page + count)
    shape = tuple(sizes[axis] for axis in order[::-1])
    axes = [order[::-1].index(axis) for axis in "TCZ"]
    table[:] = flat.reshape(2, *shape).transpose(0, *(axis + 1 for axis in axes))


def _ome_spacing(fields: dict[str, str]) -> tuple[tuple[float, float, float], str, bool, str]:
    """Spacing (z, y, x) in mm, its unit, whether the distance of the slices is said, and what is said wrongly."""
    keys = [f"PhysicalSize{axis}" for axis in "ZYX"]
    units = [mm_of(fields.get(f"{key}Unit", "um")) for key in keys]
    values = [number(fields.get(key, "0"), key) for key in keys]
    z, y, x = (length(value, mm) for value, mm in zip(values, units, strict=True))
    wrong = [
        f"{key}={fields[key][:40]}"
        for key, n in zip(keys, values, strict=True)
        if key in fields and not n > 0
    ]
    wrong += [
        f"{key}Unit={fields[f'{key}Unit'][:40]}"
        for key, mm in zip(keys, units, strict=True)
        if not mm
    ]
    return *_said((z, y, x), unit_name(units[2])), ", ".join(wrong)
