"""First surfaces: balls, boxes, seeds, label maps, thresholds, meshes, written as ``--start`` takes them.

A start is text, ``kind:values``. Coordinates are world mm (x, y, z; LPS), or in the unit at their end (``um``), and RAS
with the suffix ``ras``. With the suffix ``grid`` they are those on the scales of pictures. With the suffix ``vox`` they
are voxel indices (x, y, z; 0 is the centre of the first voxel), and a radius is in voxels of the smallest spacing.
Each start becomes a function psi on the grid, negative inside; the minimum of several is their union.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.boxes import corner_of, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.grid.window import Window
from accelsurf.image.check import as_labels
from accelsurf.image.volume import Volume
from accelsurf.io import split_name, voxels_in_mesh
from accelsurf.settings import budgets
from accelsurf.settings.labels import parse_ids
from accelsurf.settings.wording import did_you_mean, shown
from accelsurf.starts import middle_ball, psi_of_ball, psi_of_box, psi_of_mask
from accelsurf.text.coordinates import (
    SUFFIXES,
    UNITS_MM,
    Coordinates,
    System,
    box_of,
    coordinates_of,
)

#: mm or voxels.
MAX_LENGTH = 1e12

#: The start that is made of the inside clicks of the run.
CLICKS = "clicks"

#: Starts that depend on the values of the whole image.
BY_VALUES = ("seed", "threshold", "largest", "otsu")

#: Kind -> the form in which it is written.
KINDS: dict[str, str] = {
    "ball": "ball:X,Y,Z,R",
    "box": "box:X0,Y0,Z0,X1,Y1,Z1",
    "seed": "seed:X,Y,Z,R",
    "label": "label:FILE",
    "threshold": "threshold:LO,HI",
    "largest": "largest:LO,HI",
    "otsu": "otsu",
    "mesh": "mesh:FILE",
    "center": "center",
    CLICKS: CLICKS,
}


class Start(NamedTuple):
    """A start, parsed: its ``kind``, its ``numbers`` and their ``system``, or its ``file``.

    ``word`` is the text after the kind or the file: ``dark``, ``otsu``, ``ras``; ``ids`` are the labels asked for, as
    ranges; ``text`` is the start as it was written, for messages.
    """

    kind: str
    numbers: tuple[float, ...] = ()
    system: System = ""
    file: str = ""
    word: str = ""
    ids: tuple[tuple[int, int], ...] = ()
    text: str = ""

    def checked(self) -> Start:
        """Return the start, whose numbers make a shape.

        Raises
        ------
        UsageError
            When a number is too large, a radius not above 0, or a corner or threshold not below the other.
        """
        kind, numbers = self.kind, self.numbers
        is_place = kind in ("ball", "box", "seed")
        if is_place and not all(abs(v) <= MAX_LENGTH for v in numbers):
            raise UsageError(
                f"start {shown(self.text)!r}: finite numbers of at most {MAX_LENGTH:g} expected",
                f"as in {KINDS[kind]}",
            )
        if kind in ("ball", "seed") and numbers[3] <= 0:
            what = f"start {shown(self.text)!r}: radius {numbers[3]:g} given, expected above 0"
            raise UsageError(what, f"as in {KINDS[kind]}")
        if kind == "box" and any(a >= b for a, b in zip(numbers[:3], numbers[3:], strict=True)):
            what = f"start {shown(self.text)!r}: the first corner must lie below the second in x, y and z"
            raise UsageError(what, KINDS[kind])
        if kind in ("threshold", "largest") and numbers[0] > numbers[1]:
            raise UsageError(
                f"start {shown(self.text)!r}: the low threshold is above the high one",
                f"as in {KINDS[kind]}",
            )
        return self

    @property
    def vox(self) -> bool:
        """Test if the numbers are voxels; of a start that is `on` a grid."""
        return Coordinates(self.numbers, self.system).vox

    def on(self, geometry: Geometry) -> Start:
        """Return the same start with its numbers in mm (LPS) or in voxels."""
        if self.system in ("", "vox"):
            return self
        found = Coordinates(self.numbers, self.system).on(geometry)
        return self._replace(numbers=found.numbers, system=found.system)

    def mask_of(self, labels: NDArray[Any]) -> NDArray[np.bool_]:
        """Voxels of a label map that have one of the labels."""
        return has_label(labels, self.ids) if self.ids else np.asarray(labels > 0)


def has_label(labels: NDArray[Any], ids: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Voxels of a label map with a label in one of the ranges (first, last)."""
    mask = np.zeros(labels.shape, np.bool_)
    for first, last in ids:
        mask |= (labels >= first) & (labels <= last)
    return mask


def parse_start(text: str) -> Start:
    """Read one start.

    Parameters
    ----------
    text : str
        As on the command line.

    Raises
    ------
    UsageError
        When it is not of a known form.

    Examples
    --------
    >>> parse_start("ball:10,-20,5.5,12").numbers
    (10.0, -20.0, 5.5, 12.0)
    >>> parse_start("box:0,0,0,9,9,9vox").vox
    True
    """
    budgets.EXPRESSION.check(len(text), "start", kind=UsageError)
    kind, colon, rest = text.strip().partition(":")
    if kind not in KINDS:
        hint = f"{did_you_mean(kind, KINDS)}use one of {', '.join(KINDS.values())}"
        raise UsageError(f"start {shown(text)!r}: unknown kind {shown(kind)!r}", hint)
    if kind in ("center", CLICKS):
        if colon:
            raise UsageError(
                f"start {shown(text)!r}: {kind} takes no values", f"write --start {kind}, or a ball"
            )
        return Start(kind, text=text)
    if kind in ("label", "mesh"):
        return _parse_file(text, kind, rest)
    if kind == "otsu":
        if rest not in ("", "dark") or (colon and not rest):
            raise UsageError(
                f"start {shown(text)!r}: otsu or otsu:dark expected", "otsu is for bright objects"
            )
        return Start(kind, word=rest, text=text)
    if kind == "largest" and rest in ("otsu", "otsu:dark"):
        return Start(kind, word=rest, text=text)
    numbers, system = _numbers(text, kind, rest)
    return Start(kind, numbers, system, text=text).checked()


def read_starts(texts: Iterable[str]) -> list[Start]:
    """Read starts, as `parse_start` reads one."""
    return [parse_start(text) for text in texts]


def _parse_file(text: str, kind: str, rest: str) -> Start:
    """Read FILE, FILE@IDS of a label map or FILE@ras of a mesh; the name itself may have an @ or a colon."""
    file, at, tail = rest.rpartition("@") if "@" in rest else (rest, "", "")
    if not file:
        raise UsageError(f"start {shown(text)!r}: no file named", f"write {KINDS[kind]}")
    if kind == "mesh":
        return (
            Start(kind, file=file, word=tail, text=text)
            if tail in ("ras", "lps")
            else Start(kind, file=rest, text=text)
        )
    if not at or split_name(rest)[1]:
        return Start(kind, file=rest, text=text)
    ids = parse_ids(tail, f"start {shown(text)!r}", "label:FILE@2,41,251-255")
    return Start(kind, file=file, ids=ids, text=text)


def _numbers(text: str, kind: str, values: str) -> Coordinates:
    """Read the numbers of a start: a place in mm (LPS) or in voxels, or two thresholds."""
    form = KINDS[kind]
    expected = form.count(",") + 1
    parts = values.split(",")
    if kind in ("ball", "box", "seed"):
        found = box_of(values) if kind == "box" else coordinates_of(values)
    elif len(parts) == 2 and any(parts):
        # An open side, as in the energy of that name.
        found = _thresholds([parts[0].strip() or "-inf", parts[1].strip() or "inf"])
    else:
        found = None
    numbers = () if found is None else found.numbers
    if len(numbers) != expected or any(math.isnan(v) for v in numbers):
        raise UsageError(
            f"start {shown(text)!r}: {expected} numbers separated by commas expected",
            f"as in {form}",
        )
    return Coordinates(numbers, "" if found is None else found.system)


def _thresholds(parts: Sequence[str]) -> Coordinates | None:
    try:
        return Coordinates(tuple(float(value) for value in parts))
    except ValueError:
        return None


def psi_of_starts(
    starts: Sequence[Start],
    volume: Volume,
    image: NDArray[np.float32] | None = None,
    window: Window | None = None,
) -> NDArray[np.float32]:
    """Return the function psi of the union of starts on the grid of a volume.

    Parameters
    ----------
    starts : sequence of Start
        At least one.
    volume : Volume
        The image; thresholds are in its units.
    image : ndarray, shape (nz, ny, nx), optional
        Values that thresholds are applied to instead of the volume's own array (the presmoothed image).
    window : Window, optional
        The volume is this part of a larger one, to whose grid the starts belong: psi is the same as there.

    Returns
    -------
    ndarray, shape (nz, ny, nx), float32
        Negative inside. The distance (mm) for balls and boxes; half a voxel to either side for label maps and
        thresholds.

    Raises
    ------
    UsageError
        When there is no start, or one looks at values everywhere and there is but a window.
    InputError
        When a start lies outside the volume, or their union is empty or the whole volume; GeometryError when a label
        map lies on another grid.

    Examples
    --------
    >>> psi = psi_of_starts([parse_start("ball:4,4,4,2")], Volume.from_array(np.zeros((9, 9, 9))))
    >>> int((psi < 0).sum()), float(psi[4, 4, 4])
    (27, -2.0)
    """
    values = volume.array if image is None else image
    psi: NDArray[np.float32] | None = None
    window = window or Window(volume.geometry, whole_box(volume.geometry.shape))
    for start in starts:
        added = _psi_of(start.on(window.geometry), window, values)
        if not (added < 0).any():
            raise _nothing_inside(start, window.geometry)
        psi = added if psi is None else np.minimum(psi, added, out=psi)
    if psi is None:
        raise UsageError("start: none was given, expected one at least", f"as in {KINDS['ball']}")
    if (psi < 0).all():
        raise InputError(
            f"start {shown(' + '.join(start.text for start in starts))}: every voxel of the volume is inside",
            "leave some background outside",
        )
    return psi


def ball_start_of(numbers: Sequence[float], vox: bool = False) -> Start:
    """Return the start of a ball (x, y, z, r) in world mm, or in voxels.

    Raises
    ------
    UsageError
        When the radius is not above 0.

    Examples
    --------
    >>> ball_start_of((1, 2, 3, 4), vox=True).text
    'ball:1.0,2.0,3.0,4.0vox'
    """
    x, y, z, radius = (float(number) for number in numbers)
    system: System = "vox" if vox else ""
    text = f"ball:{x!r},{y!r},{z!r},{radius!r}{system}"
    return Start("ball", (x, y, z, radius), system, text=text).checked()


class IndexBall(NamedTuple):
    """A ball on a grid: its ``centre`` as an index (z, y, x), its ``radius`` in mm."""

    centre: tuple[float, float, float]
    radius: float


def ball_of(start: Start, geometry: Geometry) -> IndexBall:
    """Return the ball that a start is in a volume.

    Raises
    ------
    UsageError
        When it is no ball.
    InputError
        When no voxel centre is inside it.

    Examples
    --------
    >>> ball_of(parse_start("ball:3,4,6,2"), Geometry((9, 9, 9), (2.0, 1.0, 1.0)))
    IndexBall(centre=(3.0, 4.0, 3.0), radius=2.0)
    """
    if start.kind != "ball":
        raise UsageError(
            f"{shown(start.text)!r} was given, expected a ball", f"as in {KINDS['ball']}"
        )
    ball = _placed(start.on(geometry), geometry)
    centre = np.array(ball.centre)
    nearest = np.clip(np.round(centre), 0, np.array(geometry.shape) - 1)
    if not float(np.linalg.norm((nearest - centre) * geometry.spacing)) < ball.radius:
        raise _nothing_inside(start, geometry)
    return ball


def _placed(start: Start, geometry: Geometry) -> IndexBall:
    """Return the ball of four numbers in mm (LPS) or in voxels."""
    x, y, z, radius = start.numbers
    if start.vox:
        return IndexBall((z, y, x), radius * min(geometry.steps))
    z, y, x = (float(v) for v in geometry.world_to_index((x, y, z)))
    return IndexBall((z, y, x), radius)


def _nothing_inside(start: Start, geometry: Geometry) -> InputError:
    reason, hint = "no voxel centre is inside it", extent_hint(geometry)
    if start.kind == "label":
        reason = "the label map has no voxel of these labels"
        hint = "give a map and labels that it has"
    elif start.kind == "mesh":
        reason, hint = "no voxel centre is inside the mesh", "mm, LPS as ITK; mesh:FILE@ras for RAS"
    elif start.kind in ("threshold", "largest", "otsu"):
        reason = "no voxel lies between these values"
        hint = "thresholds are in the image's own units"
    return InputError(f"start {shown(start.text)!r}: {reason}", hint)


def extent_hint(geometry: Geometry) -> str:
    """Say where a volume lies, in its unit, and how places are written; for messages.

    Which system was meant is not said: that a place would be inside in another one is no sign that it was.
    """
    up, mm = DisplayOrientation.of(geometry), UNITS_MM[geometry.unit]
    corner = geometry.index_to_world(np.array([[0, 0, 0], [n - 1 for n in geometry.shape]]))
    low, high = corner.min(axis=0), corner.max(axis=0)
    spans = [f"{_spans('xyz', low / mm, high / mm)} {geometry.unit} (world, LPS)"]
    if not up.is_parallel:
        first = [up.coordinate(axis, 0) / mm for axis in (2, 1, 0)]
        last = [up.coordinate(axis, geometry.shape[up.order[axis]] - 1) / mm for axis in (2, 1, 0)]
        scales = _spans(up.names[::-1], first, last)
        spans.append(f"on the scales of pictures {scales} {geometry.unit}: these end in grid")
    return f"the volume's corners span {'; '.join(spans)}; numbers are mm (world, LPS) unless they end in {SUFFIXES}"


def _spans(names: Sequence[str], low: Sequence[float], high: Sequence[float]) -> str:
    """Say from where to where each axis goes."""
    return ", ".join(
        f"{name} {a:.4g} to {b:.4g}" for name, a, b in zip(names, low, high, strict=True)
    )


def _psi_of(start: Start, window: Window, values: NDArray) -> NDArray[np.float32]:
    geometry = window.geometry
    if start.kind == CLICKS:
        raise UsageError(
            f"start {start.text!r}: there is no click inside",
            "give --inside point:X,Y,Z, or another start",
        )
    if not window.is_whole:
        refuse_values(start)
    if start.kind == "center":
        return middle_ball(window)
    if start.kind == "ball":
        return psi_of_ball(window, *_placed(start, geometry))
    if start.kind == "box":
        return psi_of_box(window, start.numbers, start.vox)
    if start.kind == "label":
        mask = start.mask_of(label_box(start.file, window, f"start label:{start.file}", start.ids))
    elif start.kind == "mesh":
        mask = voxels_in_mesh(start.file, geometry, start.word, window.box)
    else:
        mask = _by_values(start, geometry, values)
    return psi_of_mask(mask, geometry)


def refuse_values(start: Start) -> None:
    """Refuse a start that looks at values everywhere, in an image that is read in parts.

    Raises
    ------
    UsageError
    """
    if start.kind in BY_VALUES:
        raise UsageError(
            f"start {shown(start.text)!r}: it looks at values everywhere, and the image is read in parts",
            "give --inside ball:X,Y,Z,R, or a ball, a box, a mesh or a label map as the start",
        )


def _by_values(start: Start, geometry: Geometry, values: NDArray) -> NDArray[np.bool_]:
    """Voxels of a start that looks at values everywhere."""
    # Not with the module: who reads a place or a box needs neither scikit-image nor SciPy.
    from accelsurf.starts import grow_region, largest, otsu

    if start.kind == "seed":
        return grow_region(values, geometry, *_placed(start, geometry))
    if start.numbers:
        # Beyond 32-bit floats a bound is open; numpy would warn.
        low, high = (math.copysign(math.inf, v) if abs(v) > 3e38 else v for v in start.numbers)
        mask = (values >= low) & (values <= high)
    else:
        mask = otsu(values, dark=start.word.endswith("dark"))
    return largest(mask) if start.kind == "largest" else mask


def label_box(
    file: str, window: Window, name: str, ids: Sequence[tuple[int, int]] = ()
) -> NDArray[Any]:
    """Return a label map, or the part of it in a window.

    Raises
    ------
    InputError
        When it cannot be read; GeometryError when it lies on another grid.
    """
    labels: Volume | io.LazyVolume = (
        io.read_labels(file, ids=ids, grid=window.geometry)
        if window.is_whole
        else io.open_volume(file)
    )
    if not labels.geometry.matches(window.geometry):
        raise GeometryError(
            f"{name}: on another grid than the image: {labels.geometry.difference(window.geometry)}",
            "resample it to the image's grid first",
        )
    return (
        labels.array
        if isinstance(labels, Volume)
        else as_labels(labels.read(window.box), corner_of(window.box))
    )
