"""Arrays, volumes, meshes and lists of balls in place of texts: as starts, masks, foreground, background."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import click_of_mask, click_of_voxels
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.clicks import Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume, array_on_grid, plain_array
from accelsurf.io import closed_mesh, from_library, voxels_inside
from accelsurf.run.setup import EnergyLike
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart, psi_of_mask
from accelsurf.text.clicks import click_of_numbers, point_voxels, read_clicks
from accelsurf.text.starts import ball_start_of, psi_of_starts

#: Settings that may be given as arrays, volumes, meshes or lists of balls.
GIVEN_KINDS = ("start", "mask", "foreground", "background", "inside", "outside")
_EXPECTED = "a text, a mask (array or Volume), a mesh with vertices and faces, or a list of (x, y, z, r) in mm"


def split_given(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate the options of `RunConfig` from those given as arrays, volumes, meshes or balls; a path is a text."""
    options = {
        key: os.fspath(value) if isinstance(value, os.PathLike) else value
        for key, value in options.items()
    }
    given = {
        key: value for key, value in options.items() if key in GIVEN_KINDS and not _is_text(value)
    }
    return {key: value for key, value in options.items() if key not in given}, given


def _is_text(value: Any) -> bool:
    if value is None or isinstance(value, str):
        return True
    return isinstance(value, Sequence) and all(isinstance(item, str) for item in value)


def given_arrays(
    objects: Any, arrays: Mapping[str, NDArray[np.float32]] | None, labels: Any = None
) -> dict[str, NDArray[Any]]:
    """Return the arrays that a run was given, by setting: psi, and label maps."""
    given: dict[str, NDArray[Any]] = dict(arrays or {})
    if surfaces := surfaces_of(objects):
        for surface in surfaces:
            given[f"object {surface.id}"] = surface.psi
            given[f"corner of object {surface.id}"] = np.array(surface.corner)
    elif objects is not None and not isinstance(objects, str):
        given["objects"] = plain_array(
            objects.array if isinstance(objects, Volume) else objects, "objects"
        )
    if labels is not None and not isinstance(labels, str):
        given["labels"] = plain_array(
            labels.array if isinstance(labels, Volume) else labels, "labels"
        )
    return given


def surfaces_of(objects: Any) -> list[ObjectStart]:
    """First surfaces of several objects where surfaces were given, in order of their ids; else none."""
    if not isinstance(objects, (tuple, list)) or not all(
        isinstance(segmented, ObjectStart) for segmented in objects
    ):
        return []
    return sorted(objects, key=lambda start: start.id)


def psi_of(name: str, value: Any, geometry: Geometry) -> NDArray[np.float32]:
    """Psi (nz, ny, nx), mm, negative inside, of the value of a setting.

    Parameters
    ----------
    name : str
        The setting, for messages.
    value : ndarray, Volume, mesh or sequence of (x, y, z, r)
        A mask: above 0 is inside. A mesh: closed, ``vertices`` (n, 3) and ``faces`` (m, 3), mm, LPS. Balls: world mm.
    geometry : Geometry
        The image's grid.

    Raises
    ------
    UsageError
        When the value is none of these.
    InputError
        When nothing of the grid is inside; GeometryError when a mask lies on another grid.
    """
    if hasattr(value, "vertices") and hasattr(value, "faces"):
        try:
            points, triangles = closed_mesh(value.vertices, value.faces)
        except InputError as error:
            raise InputError(f"{name}: the mesh: {error.message}", error.hint) from None
        inside = voxels_inside(geometry.world_to_index(points), triangles, geometry.shape)
        if not inside.any():
            raise InputError(
                f"{name}: no voxel centre is inside the mesh", "its points are mm, LPS as ITK"
            )
        return psi_of_mask(inside, geometry)
    value = from_library(value, name)
    if not isinstance(value, (Volume, np.ndarray)):
        return _balls(name, value, geometry)
    array = array_on_grid(value, geometry, name)
    inside = np.asarray(array > 0)
    if not inside.any():
        raise InputError(f"{name}: the mask is empty", "give one with voxels above 0")
    return psi_of_mask(inside, geometry)


def _balls(name: str, value: Any, geometry: Geometry) -> NDArray[np.float32]:
    try:
        table = np.array(value, float)
    except (TypeError, ValueError):
        table = np.empty(0)
    table = table[np.newaxis] if table.ndim == 1 else table
    if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
        raise UsageError(
            f"{name}: a {type(value).__name__} was given, expected {_EXPECTED}",
            "see accelsurf.segment",
        )
    balls = [ball_start_of(row) for row in table.tolist()]
    return psi_of_starts(balls, Volume(np.zeros(geometry.shape, np.uint8), geometry))


def given_clicks(side: Side, value: Any, volume: Volume) -> list[Click]:
    """Clicks from the value of ``inside`` or ``outside``: texts, masks, meshes, points (x, y, z), balls (x, y, z, r).

    Parameters
    ----------
    side : {"inside", "outside"}
    value
        One of these, or a list of them; each is a click.
    volume : Volume
        The image.

    Raises
    ------
    UsageError
        When the value is none of these.
    InputError
        When nothing of the grid is inside, or a point lies outside of it.
    """
    if isinstance(value, str):
        return read_clicks([value], side, volume)
    value = value if hasattr(value, "vertices") else from_library(value, side)
    if hasattr(value, "vertices") or isinstance(value, Volume) or _is_mask(value, volume.geometry):
        return [click_of_mask(side, psi_of(side, value, volume.geometry) < 0)]
    numbers = _numbers_of(value)
    if len(numbers) == 3:
        return [click_of_voxels(side, point_voxels([numbers], str(numbers), side, volume.geometry))]
    if len(numbers) == 4:
        return [click_of_numbers(side, numbers, False, volume.geometry)]
    if numbers or not isinstance(value, (Sequence, np.ndarray)) or len(value) == 0:
        raise UsageError(
            f"{side}: a {type(value).__name__} was given, expected a text, a mask, a mesh, a point (x, y, z), a ball "
            "(x, y, z, r), or a list of them",
            "see accelsurf.segment",
        )
    return [click for item in value for click in given_clicks(side, item, volume)]


def _is_mask(value: Any, geometry: Geometry) -> bool:
    """Return True if an array is a mask, and no table of points or balls."""
    if not isinstance(value, np.ndarray) or value.ndim < 2:
        return False
    return (
        value.ndim != 2
        or value.shape in (geometry.shape, geometry.shape[1:])
        or value.shape[1] not in (3, 4)
    )


def _numbers_of(value: Any) -> tuple[float, ...]:
    """The numbers of a point or a ball; none where the value is something else."""
    if not isinstance(value, (Sequence, np.ndarray)) or not all(
        isinstance(v, (Real, np.number)) for v in value
    ):
        return ()
    return tuple(float(number) for number in value)


def with_options(
    config: RunConfig | None,
    energy: EnergyLike | None,
    options: dict[str, Any],
    clicked: bool = False,
) -> tuple[RunConfig, EnergyLike | None]:
    """The configuration, and the energy if it is not given by name; ``clicked``: voxels inside are given as arrays."""
    if isinstance(energy, str):
        options, energy = {**options, "energy": energy}, None
    config = config or RunConfig()
    known = config.model_fields_set | options.keys()
    if energy is not None and (clicked or "inside" in options):
        # Clicks would choose another default; the energy of one's own has no model of them.
        options = {"energy": default_of("energy"), **options}
    if clicked:
        defaults = {"energy": "seeded", "start": ("clicks",)}
        options = {**{key: value for key, value in defaults.items() if key not in known}, **options}
    return config.replace(**options) if options else config, energy
