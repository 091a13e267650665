"""Clicks on several objects at once: a table of ``--objects`` with a column ``side``."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from accelsurf.clicks import click_of_voxels
from accelsurf.errors import InputError
from accelsurf.grid.boxes import corner_of, enclosing, widened
from accelsurf.grid.clicks import NO_OBJECT, Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.starts import ObjectStart, psi_of_mask
from accelsurf.text.clicks import (
    WORLD_COLUMNS,
    check_contradictions,
    click_of_numbers,
    point_voxels,
    stroke_row,
)
from accelsurf.text.coordinates import System
from accelsurf.text.objects import MAX_ID
from accelsurf.text.tables import open_table, read_table

_FORM = (
    "columns id,x,y,z,side in world mm (LPS), or id,x_vox,y_vox,z_vox,side, or id,x_grid,y_grid,z_grid,side as on the "
    "scales of pictures, with r (r_vox, r_grid) if wanted"
)


def read_object_clicks(objects: Any, geometry: Geometry) -> Clicks | None:
    """Return the clicks of a table of objects; None for a label map, or a table without a column ``side``.

    Parameters
    ----------
    objects : str, Volume or ndarray
        As for `accelsurf.text.objects.read_objects`.
    geometry : Geometry
        The image's grid.

    Raises
    ------
    InputError
        When the table cannot be read, a row is not of its form or lies outside the volume, or there is no object.
    """
    if not (isinstance(objects, str) and objects.lower().endswith(".csv")):
        return None
    if not has_sides(objects):
        return None
    rows = read_table(
        objects,
        ("id", *WORLD_COLUMNS),
        _FORM,
        lambda line, number, system: _click_of_row(line, number, system, geometry),
    )
    found = Clicks(tuple(rows), geometry.shape)
    if not any(found.ids()):
        raise InputError(
            f"{objects}: no row is inside an object", "an id from 1 on, and the side inside"
        )
    lost = {click.id for click in rows} - set(found.ids())
    if lost:
        raise InputError(
            f"{objects}: id {min(lost)} has no row inside",
            "give it one, or take its other rows away",
        )
    check_contradictions(found, geometry)
    return found


def has_sides(file: str) -> bool:
    """Return True if a table has a column ``side``: it is one of clicks, and not of balls.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    with open_table(file) as stream:
        try:
            first = next((line for line in stream if not line.startswith("#")), "")
        except UnicodeDecodeError as error:
            raise InputError(f"not a table of text ({error})", f"expected {_FORM}") from None
    return "side" in [name.strip() for name in first.split(",")]


def _click_of_row(line: dict[str, str], number: int, system: System, geometry: Geometry) -> Click:
    """The click of a row."""
    try:
        number_given = float(line.get("id") or "")
    except ValueError:
        number_given = -1.0
    if not 0 <= number_given <= MAX_ID or number_given != int(number_given):
        raise InputError(
            f"line {number}: id {line.get('id')} was given, expected a whole number from 0 on",
            _FORM,
        )
    side, (numbers, vox) = stroke_row(line, number, system, "inside", geometry)
    name, id = f"line {number}", int(number_given)
    if id == NO_OBJECT and side == "outside":
        raise InputError(
            f"{name}: id 0 is no object, so nothing is outside of it",
            "write inside, or an object's id",
        )
    if numbers[3] == 0:
        return click_of_voxels(side, point_voxels([numbers], name, side, geometry, vox), id)
    return click_of_numbers(side, numbers, vox, geometry, id)


def starts_of(clicks: Clicks, geometry: Geometry, margin: int) -> list[ObjectStart]:
    """Return the first surface of each id with clicks inside, 0 among them: these clicks.

    Parameters
    ----------
    clicks : Clicks
    geometry : Geometry
        The image's grid.
    margin : int
        Voxels around each object's clicks, where the grid has them.
    """
    out = []
    inside: dict[int, list[Click]] = {id: [] for id in clicks.ids()}
    for click in clicks.on_side("inside").clicks:
        inside[click.id].append(click)
    for id, mine in inside.items():
        tight = functools.reduce(enclosing, (click.box for click in mine))
        box = widened(tight, geometry.shape, (margin, margin, margin))
        mask = np.logical_or.reduce([click.mask_on(box) for click in mine])
        out.append(ObjectStart(id, corner_of(box), psi_of_mask(mask, geometry)))
    return out
