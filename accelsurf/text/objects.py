"""First surfaces of several objects: a label map with their ids, or a table of balls, as ``--objects`` takes them.

Each object has its own small grid, a box of the volume's voxels, so that memory grows with the boxes only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, widened
from accelsurf.grid.geometry import Geometry, ball_distance
from accelsurf.image.check import as_labels
from accelsurf.image.volume import Volume, array_on_grid
from accelsurf.settings import budgets
from accelsurf.settings.labels import IdRanges
from accelsurf.starts import ObjectStart, psi_of_mask, separated
from accelsurf.text.coordinates import Coordinates, System
from accelsurf.text.starts import MAX_LENGTH, has_label, parse_start
from accelsurf.text.tables import columns_in, read_table

#: Largest id that a label map can hold.
MAX_ID = 2**32 - 1
#: Columns of a table in world mm (LPS); in other systems they have an end.
WORLD_COLUMNS = ("id", "x", "y", "z", "r")
_BYTES_PER_VOXEL = 16  # image, psi twice, and an index of the band
_FORM = (
    "columns id,x,y,z,r in world mm (LPS), or id,x_vox,y_vox,z_vox,r_vox, or id,x_grid,y_grid,z_grid,r_grid as on the "
    "scales of pictures"
)


def read_objects(
    objects: str | Volume | NDArray[Any], geometry: Geometry, margin: int
) -> list[ObjectStart]:
    """First surfaces in order of their ids; they do not overlap.

    Parameters
    ----------
    objects : str, Volume or ndarray (nz, ny, nx)
        File of a label map on the image's grid (``FILE@2,5-9``: these ids only) or of a table of balls (.csv); or a
        label map itself.
    geometry : Geometry
        The image's grid.
    margin : int
        Voxels around each object's bounding box, where the grid has them.

    Returns
    -------
    list of ObjectStart

    Raises
    ------
    UsageError
        When the ids asked for cannot be parsed.
    InputError
        When a file cannot be read, a label is no whole number or beyond `MAX_ID`, there is no object, a ball has no
        voxel centre inside, or an object lies entirely within others; GeometryError when a label map lies on another
        grid.
    """
    if isinstance(objects, str) and objects.lower().endswith(".csv"):
        return separated(_balls(objects, geometry, margin), objects)
    name, labels = _labels(objects, geometry)
    found = np.unique(labels[labels > 0])
    check_found(name, found)
    return _of_labels(name, labels, found, geometry, margin)


def read_label_map(
    labels: str | Volume | NDArray[Any], geometry: Geometry, margin: int
) -> tuple[list[ObjectStart], NDArray[np.integer]]:
    """First surfaces of the objects of a label map that are asked for, and the labels of all others.

    Parameters
    ----------
    labels : str, Volume or ndarray (nz, ny, nx)
        File of a label map on the image's grid (``FILE@2,5-9``: these ids only), or a label map itself.
    geometry, margin
        As of `read_objects`.

    Returns
    -------
    starts : list of ObjectStart
        In order of their ids.
    others : ndarray (nz, ny, nx)
        The map without them, of its own type.

    Raises
    ------
    UsageError, InputError
        As of `read_objects`.
    """
    name, whole, ids = _read_labels(labels, geometry, "labels")
    wanted = whole if not ids else np.where(has_label(whole, ids), whole, 0)
    found = np.unique(wanted[wanted > 0])
    if ids and found.size == 0:
        raise _no_label(f"labels {name}", whole)
    check_found(name, found, "labels")
    return _of_labels(name, wanted, found, geometry, margin), np.where(wanted > 0, 0, whole).astype(
        whole.dtype
    )


def _of_labels(
    name: str,
    labels: NDArray[np.integer],
    found: NDArray[np.integer],
    geometry: Geometry,
    margin: int,
) -> list[ObjectStart]:
    """Starts of the ids of a label map, after a check of the size of their boxes."""
    places = np.where(labels > 0, np.searchsorted(found, labels) + 1, 0).astype(np.int32)
    boxes = [
        widened(box, geometry.shape, (margin, margin, margin))
        for box in ndimage.find_objects(places)
    ]
    _check_boxes(name, boxes, geometry)
    out = []
    for place, (id, grown) in enumerate(zip(found, boxes, strict=True), start=1):
        out.append(
            ObjectStart(int(id), corner_of(grown), psi_of_mask(places[grown] == place, geometry))
        )
    return out


def _check_boxes(name: str, boxes: list[Box], geometry: Geometry) -> None:
    """Refuse objects whose boxes together need too many voxels, as with an image that was taken for a label map."""
    voxels = sum(math.prod(s.stop - s.start for s in box) for box in boxes)
    image = math.prod(geometry.shape)
    given = f"objects {name}: the boxes around {len(boxes)} objects in an image of {image} voxels"
    budgets.OBJECT_VOXELS.check(voxels, given, image + (1 << 18))
    needed, available = voxels * _BYTES_PER_VOXEL, io.available_memory()
    if needed > available:
        raise InputError(
            f"{given} need about {needed / 2**30:.2f} GiB of memory, {available / 2**30:.2f} GiB are available",
            budgets.OBJECT_VOXELS.hint,
        )


def _labels(
    objects: str | Volume | NDArray[Any], geometry: Geometry
) -> tuple[str, NDArray[np.integer]]:
    """Name of the label map, and its values: 0 where an id was not asked for."""
    name, whole, ids = _read_labels(objects, geometry, "objects")
    if ids and not has_label(whole, ids).any():
        # Only the labels that are asked for may have been read.
        file = parse_start(f"label:{objects}").file
        raise _no_label(f"objects {name}", io.read_labels(file, grid=geometry).array)
    return name, whole if not ids else np.where(has_label(whole, ids), whole, 0)


def _read_labels(
    given: str | Volume | NDArray[Any], geometry: Geometry, what: str
) -> tuple[str, NDArray[np.integer], IdRanges]:
    """Name of a label map, all its values, and the ids that are asked for, none for all; ``what`` is the setting."""
    ids: IdRanges = ()
    name = "label map"
    if isinstance(given, str):
        name, start = given, parse_start(f"label:{given}")
        # Of labels that may overlap those are read that are asked for; of a map that is mended, all.
        given, ids = (
            io.read_labels(start.file, ids=start.ids if what == "objects" else (), grid=geometry),
            start.ids,
        )
    return (
        name,
        whole_numbers(name, array_on_grid(given, geometry, f"{what} {name}"), (), what=what),
        ids,
    )


def _no_label(what: str, whole: NDArray[Any]) -> InputError:
    """The error about a map without the labels that are asked for."""
    there = ", ".join(str(label) for label in np.unique(whole[whole > 0])[:20].tolist())
    return InputError(
        f"{what}: no voxel has a label that is asked for", f"there are {there or 'none'}"
    )


def whole_numbers(
    name: str,
    labels: NDArray[Any],
    ids: Sequence[tuple[int, int]],
    corner: Corner = (0, 0, 0),
    what: str = "objects",
) -> NDArray[np.integer]:
    """Return labels as integers, 0 where an id was not asked for.

    Parameters
    ----------
    name : str
        Of the map, for messages.
    labels : ndarray (nz, ny, nx)
    ids : sequence of (first, last)
        Those asked for; none for all.
    corner : (z, y, x)
        First voxel of the labels in the map, for messages.
    what : str, optional
        The setting, for messages.

    Raises
    ------
    InputError
        When one is no whole number.
    """
    try:
        labels = as_labels(labels, corner)
    except InputError as error:
        raise InputError(f"{what} {name}: {error.message}", error.hint) from None
    if ids:
        labels = np.where(has_label(labels, ids), labels, 0)
    return labels


def check_found(name: str, found: NDArray[np.integer], what: str = "objects") -> None:
    """Refuse the ids of a label map, ascending, where there is none or one is too large; ``what`` is the setting.

    Raises
    ------
    InputError
    """
    if found.size == 0:
        hint = (
            "give each object's first voxels its id"
            if what == "objects"
            else "is it the label map of this image?"
        )
        raise InputError(f"{what} {name}: no voxel has a label above 0", hint)
    if int(found[-1]) > MAX_ID:
        raise InputError(
            f"{what} {name}: id {found[-1]} was given, expected at most {MAX_ID}", "renumber them"
        )


def read_balls(file: str, geometry: Geometry) -> dict[int, list[tuple[float, float, float, float]]]:
    """Return the balls (z, y, x, r) of each id of a table, in order of the ids: voxel indices, r in mm.

    Raises
    ------
    InputError
        When it cannot be read, or has no row.
    """
    rows: dict[int, list[tuple[float, float, float, float]]] = {}
    for id, *numbers in read_table(
        file,
        WORLD_COLUMNS,
        _FORM,
        lambda line, number, system: _read_line(line, number, system, geometry),
    ):
        rows.setdefault(int(id), []).append((numbers[0], numbers[1], numbers[2], numbers[3]))
    if not rows:
        raise InputError(f"{file}: it has no row", f"expected {_FORM}")
    return dict(sorted(rows.items()))


def _balls(file: str, geometry: Geometry, margin: int) -> list[ObjectStart]:
    """Balls of a table, one start for all balls of an id, in order of their ids."""
    rows = read_balls(file, geometry)
    out: list[ObjectStart] = []
    for id in rows:
        out.append(ball_start(file, id, rows[id], geometry, margin))
        if len(out) % 64 == 0:
            _check_boxes(file, [box_at(start.corner, start.psi.shape) for start in out], geometry)
    _check_boxes(file, [box_at(start.corner, start.psi.shape) for start in out], geometry)
    return out


def _read_line(
    line: dict[str, Any], number: int, system: System, geometry: Geometry
) -> tuple[float, ...]:
    try:
        id, x, y, z, r = (float(line.get(name, "")) for name in columns_in(system, WORLD_COLUMNS))
    except (TypeError, ValueError):
        id = x = y = z = r = math.nan
    if (
        not all(abs(v) <= MAX_LENGTH for v in (id, x, y, z, r))
        or id != int(id)
        or not 1 <= id <= MAX_ID
    ):
        given = ",".join(str(value) for value in line.values() if isinstance(value, str))
        raise InputError(
            f"line {number}: {given} was given, expected a whole number from 1 on and four numbers",
            f"{_FORM}",
        )
    if r <= 0:
        raise InputError(f"line {number}: radius {r:g} was given, expected above 0", f"{_FORM}")
    found = Coordinates((x, y, z, r), system).on(geometry)
    (x, y, z, r), vox = found.numbers, found.vox
    index = (z, y, x) if vox else tuple(float(v) for v in geometry.world_to_index((x, y, z)))
    return id, *index, r * (min(geometry.steps) if vox else 1.0)


def ball_box(
    file: str,
    id: int,
    balls: list[tuple[float, float, float, float]],
    geometry: Geometry,
    margin: int,
) -> Box:
    """Voxels of a grid around balls, with a margin where the grid has it.

    Parameters
    ----------
    file : str
        Names the table in messages.
    id : int
        The object's id.
    balls : list of (z, y, x, r)
        Voxel index of the centre, and radius in mm.
    geometry : Geometry
    margin : int
        Voxels.

    Raises
    ------
    InputError
        When they lie outside of the grid, or there are too many of them.
    """
    table = np.array(balls)
    radius = table[:, 3:] / geometry.spacing
    n = np.array(geometry.shape)
    begin = np.clip(np.floor((table[:, :3] - radius).min(axis=0)), 0, n).astype(int)
    end = np.clip(np.ceil((table[:, :3] + radius).max(axis=0)) + 1, 0, n).astype(int)
    if (begin >= end).any():
        raise InputError(f"{file}: ball {id} lies outside of the volume", _FORM)
    a, b, c = (slice(int(i), int(j)) for i, j in zip(begin, end, strict=True))
    box = widened((a, b, c), geometry.shape, (margin, margin, margin))
    voxels = math.prod(s.stop - s.start for s in box)
    budgets.BALLS.check(len(balls) * voxels, f"{file}: {len(balls)} balls of id {id}")
    return box


def ball_start(
    file: str,
    id: int,
    balls: list[tuple[float, float, float, float]],
    geometry: Geometry,
    margin: int,
) -> ObjectStart:
    """The union of balls; for the parameters see `ball_box`.

    Raises
    ------
    InputError
        As `ball_box`, and when no voxel centre is inside.
    """
    box = ball_box(file, id, balls, geometry, margin)
    psi = np.full(tuple(s.stop - s.start for s in box), np.inf, np.float32)
    for *centre, r in balls:
        np.minimum(psi, ball_distance(box, geometry.spacing, centre, r), out=psi)
    if not (psi < 0).any():
        raise InputError(
            f"{file}: no voxel centre is inside ball {id}",
            "a larger r, or is the unit the right one?",
        )
    return ObjectStart(id, corner_of(box), psi)
