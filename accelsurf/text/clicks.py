"""Clicks from texts and files into voxels: points, balls, paths, strokes, and every kind of start.

The only reader of clicks, inside and outside of an object. It also refuses clicks that contradict each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import click_of_ball, click_of_mask, click_of_path, click_of_voxels
from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import (
    corner_of,
    meeting,
    whole_box,
)
from accelsurf.grid.clicks import NO_OBJECT, SIDES, Click, Clicks, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from accelsurf.image.volume import Volume
from accelsurf.settings import budgets
from accelsurf.settings.wording import shown
from accelsurf.text.coordinates import (
    Coordinates,
    System,
    coordinates_of,
    is_point_file,
    place_text,
    split_suffix,
    suffix_of,
)
from accelsurf.text.point_files import has_own_columns, read_points
from accelsurf.text.starts import KINDS as START_KINDS
from accelsurf.text.starts import (
    MAX_LENGTH,
    IndexBall,
    Start,
    ball_of,
    ball_start_of,
    extent_hint,
    label_box,
    parse_start,
    psi_of_starts,
)
from accelsurf.text.tables import columns_in, read_table
from accelsurf.text.voxel_lists import click_of_voxels_text

#: How it is written; with the suffix ``vox`` in voxels, as a ball.
_PATH_FORM = "path:X,Y,Z,R;X,Y,Z,R;..."
#: Kinds of clicks besides the kinds of starts -> the form in which they are written.
KINDS = {"point": "point:X,Y,Z", "path": _PATH_FORM, "stroke": "stroke:FILE"}
#: Columns of a stroke in world mm (LPS); a radius makes balls, a side overrides the option's.
WORLD_COLUMNS = ("x", "y", "z")
_STROKE = (
    "columns x,y,z in world mm (LPS), or x_vox,y_vox,z_vox, or x_grid,y_grid,z_grid as on the scales of pictures, "
    "with r (r_vox, r_grid) and side if wanted"
)
_LABELS: dict[int, Side] = {1: "inside", 2: "outside"}


def _parse_path(text: str, geometry: Geometry) -> tuple[Floats, bool]:
    """Read the numbers of a path: rows x, y, z, r, and whether they are voxels.

    Raises
    ------
    UsageError
        When it is not of the form.

    Examples
    --------
    >>> _parse_path("path:1,2,3,4;5,6,7,4", Geometry((9, 9, 9), (1.0, 1.0, 1.0)))[0].tolist()
    [[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 4.0]]
    """
    budgets.PATH.check(len(text), "a path", kind=UsageError)
    rest, suffix = split_suffix(text.strip().removeprefix("path:"))
    try:
        read = [
            suffix.coordinates([float(value) for value in row.split(",")])
            for row in rest.split(";")
        ]
    except ValueError:
        read = [Coordinates(())]
    rows = [found.numbers for found in read]
    if any(
        len(row) != 4 or not 0 <= row[3] or not all(abs(v) <= MAX_LENGTH for v in row)
        for row in rows
    ):
        raise UsageError(
            f"click {shown(text)!r}: x, y, z and a radius for each place expected",
            f"as in {_PATH_FORM}",
        )
    placed = [found.on(geometry) for found in read]
    return np.array([found.numbers for found in placed]), placed[0].vox


def _click_of_path(text: str, side: Side, geometry: Geometry, id: int) -> Click:
    """Return the click of a path, ``path:X,Y,Z,R;...``."""
    rows, is_vox = _parse_path(text, geometry)
    places = rows[:, 2::-1] if is_vox else geometry.world_to_index(rows[:, :3])
    radii = rows[:, 3] * min(geometry.steps) if is_vox else rows[:, 3]
    click = click_of_path(side, places, radii, geometry, id)
    if click is None:
        raise InputError(f"{side} {shown(text)!r}: no voxel is in it", extent_hint(geometry))
    return click


def read_clicks(
    texts: Iterable[str],
    side: Side,
    volume: Volume,
    image: NDArray[np.float32] | None = None,
    id: int = 1,
    window: Window | None = None,
) -> list[Click]:
    """Return clicks from texts, in their order.

    Parameters
    ----------
    texts : iterable of str
        ``point:X,Y,Z``, ``X,Y,Z`` alone, ``path:X,Y,Z,R;X,Y,Z,R;...``, ``stroke:FILE``, ``voxels:...`` as
        `voxels_text` writes them, a file of points of another program, or a start.
    side : {"inside", "outside"}
    volume : Volume
        The image.
    image : ndarray (nz, ny, nx), optional
        Values for seeds and thresholds, as for `accelsurf.text.starts.psi_of_starts`.
    id : int, optional
        Of the object.
    window : Window, optional
        The volume is this part of a larger one, to whose grid the texts belong; clicks are counted from its first
        voxel, and voxels beyond it are left out.

    Raises
    ------
    UsageError
        When one is not of a known form.
    InputError
        When one lies outside the volume, or a file cannot be read; GeometryError when a label map lies on another grid.
    """
    out: list[Click] = []
    window = window or Window(volume.geometry, whole_box(volume.geometry.shape))
    for text in texts:
        kind, colon, rest = text.strip().partition(":")
        if kind == "path":
            out += _within(window, [_click_of_path(text, side, window.geometry, id)])
        elif kind == "voxels":
            out += _within(window, [click_of_voxels_text(text, side, window.geometry, id)])
        elif kind == "stroke":
            out += _stroke(text, rest, side, window, id)
        elif kind not in START_KINDS and is_point_file(text):
            out += _of_file(text.strip(), side, window, id)
        elif kind == "point" or (not colon and "," in kind):
            out += _of_points([read_point(text)], text, side, window, id)
        else:
            out += _of_start(text, side, volume, image, id, window)
    return out


def _of_file(file: str, side: Side, window: Window, id: int) -> list[Click]:
    """Return the clicks of a file of points: a table of this program, or a file of another one."""
    if has_own_columns(file):
        return _stroke(file, file, side, window, id)
    return _of_points(read_points(file), Path(file).name, side, window, id)


def _of_points(
    points: Iterable[Coordinates], name: str, side: Side, window: Window, id: int
) -> list[Click]:
    """Return a click of one voxel for each point within the window; ``name`` is for messages."""
    out: list[Click] = []
    for point in points:
        found = point.on(window.geometry)
        voxels = point_voxels([found.numbers], name, side, window.geometry, found.vox)
        out += _within(window, [click_of_voxels(side, voxels, id)])
    return out


def _within(window: Window, clicks: Sequence[Click]) -> list[Click]:
    """Return clicks of the whole grid counted from the window's first voxel; voxels beyond are left out."""
    return list(Clicks(tuple(clicks), window.geometry.shape).on_box(window.box).clicks)


class Clicked(Protocol):
    """Settings or a correction: clicks in an object, and not in it, as texts."""

    @property
    def inside(self) -> tuple[str, ...]:
        """In the object."""
        ...

    @property
    def outside(self) -> tuple[str, ...]:
        """Not in it."""
        ...


def clicks_of(
    written: Clicked,
    volume: Volume,
    image: NDArray[np.float32] | None = None,
    id: int | None = None,
    has_ids: bool = False,
    window: Window | None = None,
) -> list[Click]:
    """Read the clicks of settings or of a correction on the image's grid; the only reader of both sides.

    Parameters
    ----------
    written : Clicked
    id : int, optional
        The object that they are about; without it, and among objects with ids, the clicks are in no object.
    has_ids : bool
        True if there are several objects.
    volume, image, window
        As of `read_clicks`.
    """
    read = [
        click
        for side in SIDES
        for click in read_clicks(getattr(written, side), side, volume, image, id or 1, window)
    ]
    return (
        [click._replace(side="inside", id=NO_OBJECT) for click in read]
        if has_ids and not id
        else read
    )


def first_place(text: str, geometry: Geometry) -> IndexBall:
    """Return the place at which a text of clicks begins, as a ball that is not outside of the volume.

    Parameters
    ----------
    text : str
        ``ball:X,Y,Z,R``, ``point:X,Y,Z``, or ``path:X,Y,Z,R;...``.
    geometry : Geometry
        The image's grid.

    Raises
    ------
    UsageError, InputError
        When it is none of these or lies outside.
    """
    kind, _, rest = text.partition(":")
    if kind not in ("point", "path"):
        return ball_of(parse_start(text), geometry)
    if kind == "path":
        body, _ = split_suffix(rest)
        rest = ",".join(body.partition(";")[0].split(",")[:3]) + rest[len(body) :]
    place = read_point(rest).on(geometry)
    # Its voxel has its centre within a ball of this radius.
    radius = float(np.linalg.norm(geometry.spacing)) + 1.0
    return ball_of(Start("ball", (*place.numbers, radius), place.system, text=text), geometry)


def check_contradictions(
    clicks: Clicks, geometry: Geometry, first: Sequence[int] = (0, 0, 0)
) -> None:
    """Refuse voxels that are clicked on both sides of an object, or inside two objects.

    Parameters
    ----------
    clicks : Clicks
    geometry : Geometry
        The image's grid.
    first : sequence of int, optional
        Index (z, y, x) in the image of the first voxel of the clicks' grid.

    Raises
    ------
    InputError
        With the first of these voxels, as index and in mm.
    """
    boxes = np.array(
        [[(side.start, side.stop) for side in click.box] for click in clicks.clicks]
    ).reshape(-1, 3, 2)
    found = []
    for click, near in zip(clicks.clicks, meeting(boxes[..., 0], boxes[..., 1]), strict=True):
        for other in (clicks.clicks[number] for number in near):
            both = click.mask & other.mask_on(click.box)
            if click.contradicts(other) and both.any():
                voxel = np.argwhere(both)[0] + np.array(corner_of(click.box))
                found.append((min(click.id, other.id), *voxel.tolist()))
    if found:
        id, *voxel = min(found)
        of = "" if {click.id for click in clicks.clicks} == {1} else f" of object {id}"
        where = voxel_named(np.array(voxel), geometry, first)
        raise InputError(
            f"clicks: {where} is clicked both inside and outside{of}",
            "take one away, or make one smaller",
        )


def check_left(before: Clicks, after: Clicks) -> None:
    """Refuse later clicks that leave no voxel clicked inside of an object that had some ``before``.

    Raises
    ------
    InputError
        With the object, where there are several.
    """
    for id in sorted(set(before.ids()) - set(after.ids()) - {NO_OBJECT}):
        of = "" if {click.id for click in before.clicks} == {1} else f" of object {id}"
        raise InputError(
            f"clicks: nothing would be left that is clicked inside{of}",
            "click inside elsewhere first, or smaller",
        )


def voxel_named(
    index: NDArray[np.int64], geometry: Geometry, first: Sequence[int] = (0, 0, 0)
) -> str:
    """Return the name of a voxel (z, y, x) in messages: its index x,y,z in the image, and its place."""
    place = np.asarray(index) + np.asarray(first)
    world = place_text(geometry.index_to_world(place.astype(float)).tolist(), geometry)
    world += "" if suffix_of(geometry) else " mm"
    voxel = ",".join(str(int(i)) for i in place[::-1])
    return f"voxel {voxel} (x,y,z; {world})"


def point_voxels(
    points: Sequence[Sequence[float]], name: str, side: str, geometry: Geometry, vox: bool = False
) -> NDArray[np.int64]:
    """Return the voxels (n, 3), z y x, in which points (x, y, z) lie.

    Raises
    ------
    InputError
        When one lies outside the volume.
    """
    places = np.array([[float(v) for v in point[:3]] for point in points])
    index = (
        places[:, ::-1]
        if vox
        else np.array([geometry.world_to_index(tuple(place)) for place in places])
    )
    voxels = np.floor(index + 0.5).astype(np.int64)
    beyond = ((voxels < 0) | (voxels >= np.array(geometry.shape))).any(axis=1)
    if beyond.any():
        place = places[int(np.flatnonzero(beyond)[0])].tolist()
        given = ",".join(f"{v:g}" for v in place) + ("vox" if vox else "")
        raise InputError(
            f"{side} {shown(name)!r}: {given} lies outside of the volume",
            extent_hint(geometry),
        )
    return voxels


def click_of_numbers(
    side: Side, ball: Sequence[float], vox: bool, geometry: Geometry, id: int = 1
) -> Click:
    """Return a click of a ball (x, y, z, r) in world mm, or in voxels.

    Raises
    ------
    InputError
        When no voxel centre is inside it.
    """
    try:
        return click_of_ball(side, *ball_of(ball_start_of(ball, vox), geometry), geometry, id)
    except AccelsurfError as error:
        raise type(error)(error.message.replace("start ", f"{side} ", 1), error.hint) from None


def read_point(text: str) -> Coordinates:
    """Return the place of a click ``point:X,Y,Z``, or ``X,Y,Z`` alone.

    Raises
    ------
    UsageError
        When it is not of this form.
    """
    budgets.EXPRESSION.check(len(text), "a point", kind=UsageError)
    point = coordinates_of(text.strip().removeprefix("point:"))
    if (
        point is None
        or len(point.numbers) != 3
        or not all(abs(v) <= MAX_LENGTH for v in point.numbers)
    ):
        raise UsageError(
            f"click {shown(text)!r}: 3 numbers separated by commas expected",
            f"as in {KINDS['point']}",
        )
    return point


def _of_start(
    text: str,
    side: Side,
    volume: Volume,
    image: NDArray[np.float32] | None,
    id: int,
    window: Window,
) -> list[Click]:
    """A click that is written as a start."""
    try:
        start = parse_start(text)
        if start.kind == "ball":
            return _within(
                window,
                [click_of_ball(side, *ball_of(start, window.geometry), window.geometry, id)],
            )
        return [click_of_mask(side, psi_of_starts([start], volume, image, window) < 0, id)]
    except AccelsurfError as error:
        message = error.message.replace("start ", f"{side} ", 1)
        hint = (
            error.hint.replace("use one of ", f"use one of {', '.join(KINDS.values())}, ")
            if error.hint
            else ""
        )
        raise type(error)(message, hint) from None


def _stroke(text: str, file: str, side: Side, window: Window, id: int) -> list[Click]:
    """The clicks of a file: points, or a label map with 1 inside and 2 outside."""
    if not file:
        raise UsageError(f"click {shown(text)!r}: no file named", f"write {KINDS['stroke']}")
    if file.lower().endswith(".csv"):
        return _within(window, _stroke_of_points(file, side, window.geometry, id))
    labels = label_box(file, window, f"stroke:{file}")
    found = [int(value) for value in np.unique(labels)]
    unknown = [value for value in found if value not in (0, *_LABELS)]
    if unknown:
        raise InputError(
            f"stroke:{file}: label {unknown[0]} was given, expected 1 (inside), 2 (outside) and 0",
            "",
        )
    masks = {way: labels == label for label, way in _LABELS.items()}
    if not masks[side].any():
        raise InputError(
            f"{side} stroke:{file}: no voxel has its label", "1 is inside, 2 is outside"
        )
    return [click_of_mask(way, masks[way], id) for way in SIDES if masks[way].any()]


def _stroke_of_points(file: str, side: Side, geometry: Geometry, id: int) -> list[Click]:
    """The clicks of a table: one for the points of each side, and one for each ball."""
    rows = read_table(
        file,
        WORLD_COLUMNS,
        _STROKE,
        lambda line, number, system: stroke_row(line, number, system, side, geometry),
    )
    if not rows:
        raise InputError(f"{file}: it has no row", f"expected {_STROKE}")
    vox, out = rows[0][1][1], list[Click]()
    for way in SIDES:
        points = [
            numbers[:3] for row_side, (numbers, _) in rows if row_side == way and numbers[3] == 0
        ]
        if points:
            out.append(click_of_voxels(way, point_voxels(points, file, way, geometry, vox), id))
    return out + [
        click_of_numbers(way, numbers, vox, geometry, id)
        for way, (numbers, _) in rows
        if numbers[3] > 0
    ]


def stroke_row(
    line: dict[str, str], number: int, system: System, side: Side, geometry: Geometry
) -> tuple[Side, tuple[tuple[float, ...], bool]]:
    """Side of a row of a stroke, its (x, y, z, r), and whether these are voxels; r is 0 for a point.

    Raises
    ------
    InputError
        When it has no three numbers, a radius below 0, or another side.
    """
    given = ",".join(str(value) for value in line.values() if isinstance(value, str))
    names = columns_in(system, (*WORLD_COLUMNS, "r"))
    try:
        numbers = tuple(
            float(line.get(name) or ("0" if name.startswith("r") else "")) for name in names
        )
    except (TypeError, ValueError):
        numbers = ()
    if not numbers or not all(abs(v) <= MAX_LENGTH for v in numbers) or numbers[3] < 0:
        raise InputError(
            f"line {number}: {given} was given, expected three numbers, and no radius below 0",
            _STROKE,
        )
    found = Coordinates(numbers, system).on(geometry)
    return side_of(line, number, side), (found.numbers, found.vox)


def side_of(line: dict[str, str], number: int, otherwise: Side) -> Side:
    """The side that a row of a table names, ``otherwise`` where it names none.

    Raises
    ------
    InputError
        When it names another one.
    """
    word = (line.get("side") or "").strip().lower()
    for side in SIDES:
        if word == side:
            return side
    if word:
        raise InputError(
            f"line {number}: side {shown(word)} was given, expected inside or outside", _STROKE
        )
    return otherwise
