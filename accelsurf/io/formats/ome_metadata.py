"""Metadata of OME-Zarr images: axes, levels, and the places of their voxels.

Versions 0.4 and 0.5 differ in the place of the metadata only. Axes of space are given in their order in the array;
lengths may have any unit. Axes along lines of the body say from which side of the patient to which their
coordinates increase (RFC-4 of OME-NGFF); the words for quadrupeds are taken as DICOM places both kinds of patients:
dorsal where posterior is, cranial and rostral where superior is. For other directions OME-Zarr has nothing: accelsurf
keeps them in an attribute of its own when it writes, with the metadata of `accelsurf.image.volume.Volume`, and
which chunks it wrote.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.io.formats.zarr_files import STORED_KEY
from accelsurf.io.headers import (
    FRAME_KEY,
    ORIENTED_KEY,
    UNIT_KEY,
    WARNING_KEY,
    is_anatomical,
    with_warnings,
)
from accelsurf.settings import budgets
from accelsurf.settings.wording import mm_of, seconds_of, unit_name

#: Name of the attribute that accelsurf writes.
OWN_KEY = "accelsurf"
MAX_AXES = 5
VERSIONS = ("0.4", "0.5")
_DAMAGED_HINT = "is the store complete? copy or export it again"
#: Sides towards which x, y and z of the world (LPS) increase, and those that they come from.
_SIDES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))


@dataclass(frozen=True)
class OmeAxis:
    """An axis of the arrays.

    Attributes
    ----------
    name : str
    kind : str
        "space", "time", "channel", or another word.
    unit : str
        Empty where none is given.
    orientation : str
        Of `word_of`.
    """

    name: str
    kind: str
    unit: str = ""
    orientation: str = ""


@dataclass(frozen=True)
class OmeLevel:
    """A level of the pyramid.

    Attributes
    ----------
    path : str
        Of its array, within the image.
    scale, translation : tuple of float
        Along each axis, in the unit of the axis.
    """

    path: str
    scale: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class OmeMetadata:
    """The metadata of an image.

    Attributes
    ----------
    version : str
        Of OME-Zarr.
    axes : tuple of OmeAxis
    levels : tuple of OmeLevel
        Finest first.
    direction : ndarray (3, 3)
        As in `Geometry`; the identity where nothing says it.
    metadata : dict of str to str
        As in `Volume`, with a warning where the axes have no unit.
    stored : dict of str to list of int
        Of arrays that accelsurf has written, the files of their chunks as `zarr_files.runs_of` says it.
    """

    version: str
    axes: tuple[OmeAxis, ...]
    levels: tuple[OmeLevel, ...]
    direction: Floats
    metadata: dict[str, str] = field(default_factory=dict)
    stored: dict[str, list[int]] = field(default_factory=dict)

    @property
    def space_axes(self) -> tuple[int, ...]:
        """Numbers of the axes z, y, x, or y, x; by their names, else in the order of the array."""
        return _space_axes(self.axes)

    def geometry(self, level: int, shape: Sequence[int]) -> Geometry:
        """The grid of a level whose array has a shape.

        Raises
        ------
        GeometryError
            When it is none.
        """
        axes = self.space_axes
        units = [_mm_per_unit(self.axes[i].unit) for i in axes]
        here, finest = self.levels[level], self.levels[0]
        spacing = [here.scale[i] * unit for i, unit in zip(axes, units, strict=True)]
        first = [finest.translation[i] * unit for i, unit in zip(axes, units, strict=True)]
        shift = [
            (here.translation[i] - finest.translation[i]) * unit
            for i, unit in zip(axes, units, strict=True)
        ]
        flat = 3 - len(axes)  # one slice, of 1 mm
        origin = np.array([*first[::-1], *[0.0] * flat])
        if level:  # the finest is placed exactly
            origin = origin + self.direction @ np.array([*shift[::-1], *[0.0] * flat])
        x, y, z = origin.tolist()
        counts = (*[1] * flat, *(int(shape[i]) for i in axes))
        return Geometry(counts, (*[1.0] * flat, *spacing), (x, y, z), self.direction)  # type: ignore[arg-type]


def parse_attributes(attributes: Mapping[str, Any]) -> OmeMetadata:
    """Read the attributes of a group.

    Raises
    ------
    InputError
        When it is no image of a known version, or the metadata are damaged.
    """
    ome = attributes.get("ome", attributes)
    if not isinstance(ome, Mapping) or "multiscales" not in ome:
        raise InputError(*_other_kind(ome if isinstance(ome, Mapping) else {}))
    try:
        (scales, *others) = ome["multiscales"]
        version = str(ome["version"] if "ome" in attributes else scales.get("version", "0.4"))
        if version not in VERSIONS:
            raise InputError(
                f"OME-Zarr {version[:20]} given, {' or '.join(VERSIONS)} expected",
                "convert it, e.g. with ngff-zarr",
            )
        if others:
            raise InputError(
                f"{1 + len(others)} images in one group given, one expected", "save them apart"
            )
        budgets.ZARR_LEVELS.check(len(scales["datasets"]))
        if len(scales["axes"]) > MAX_AXES:
            given = len(scales["axes"])
            raise InputError(
                f"an OME-Zarr of {given} axes given, at most {MAX_AXES} expected", _DAMAGED_HINT
            )
        axes = tuple(
            OmeAxis(
                str(axis["name"]),
                str(axis.get("type") or ""),
                str(axis.get("unit") or ""),
                word_of(axis),
            )
            for axis in scales["axes"]
        )
        common = scales.get("coordinateTransformations")
        levels = tuple(_level(dataset, common, len(axes)) for dataset in scales["datasets"])
        direction, metadata, stored = _own(attributes.get(OWN_KEY, {}))
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        message = f"the OME-Zarr metadata are damaged ({type(error).__name__}: {error})"
        raise InputError(message, _DAMAGED_HINT) from None
    space = [axis for axis in axes if axis.kind == "space"]
    if not levels or not 2 <= len(space) <= 3:
        raise InputError(
            f"an OME-Zarr of {len(levels)} levels with axes {', '.join(axis.name for axis in axes)} given, "
            "expected one level or more, with two or three axes of space",
            _DAMAGED_HINT,
        )
    if all(not axis.unit for axis in space):
        metadata = with_warnings(
            metadata, "the OME-Zarr gives no unit of length: it is taken as mm"
        )
    units = [_mm_per_unit(axis.unit) for axis in space]
    if (unit := unit_name(units[-1])) != "mm":
        metadata[UNIT_KEY] = unit
    for axis, step in zip(axes, levels[0].scale, strict=True):
        if axis.kind == "time" and (seconds := step * seconds_of(axis.unit)) > 0:
            metadata[FRAME_KEY] = repr(seconds)
    direction, metadata = _placed(axes, levels[0], direction, metadata)
    return OmeMetadata(version, axes, levels, direction, metadata, stored)


def _other_kind(ome: Mapping[str, Any]) -> tuple[str, str]:
    """Name the kind of a group that is no image, and the remedy."""
    if "plate" in ome:
        return (
            "an OME-Zarr plate of many images given, one image expected",
            "give one of its fields, as PLATE/A/1/0",
        )
    if "well" in ome:
        return (
            "an OME-Zarr well of many fields given, one image expected",
            "give one of them, as WELL/0",
        )
    if "labels" in ome:
        names = ", ".join(map(str, ome["labels"][:5])) if isinstance(ome["labels"], list) else ""
        return (
            f"the label maps of an OME-Zarr given ({names}), one image expected",
            "give one of them, as labels/NAME",
        )
    return "an OME-Zarr without an image given", "give the group of one of its images"


def _level(dataset: Mapping[str, Any], common: Any, axes: int) -> OmeLevel:
    """Return a level by its own transformations, and then the common ones."""
    path = str(dataset["path"])
    if (
        not path
        or path.startswith(("/", "\\"))
        or ".." in path.replace("\\", "/").split("/")
        or "\0" in path
    ):
        raise ValueError(f"the path of a level is {path!r}")
    scale, translation = _transform(dataset["coordinateTransformations"], axes)
    if common:
        more, offset = _transform(common, axes)
        translation = tuple(m * t + o for m, t, o in zip(more, translation, offset, strict=True))
        scale = tuple(m * s for m, s in zip(more, scale, strict=True))
    return OmeLevel(path, scale, translation)


def _transform(given: Any, axes: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Scale and translation of a list of transformations: one scale, then perhaps one translation."""
    kinds = [transform["type"] for transform in given]
    if kinds not in (["scale"], ["scale", "translation"]):
        raise ValueError(
            f"coordinateTransformations are {kinds}, expected a scale, then perhaps a translation"
        )
    numbers = [tuple(float(value) for value in transform[transform["type"]]) for transform in given]
    if any(len(some) != axes or not all(map(math.isfinite, some)) for some in numbers):
        raise ValueError(f"a transformation of {axes} finite numbers expected")
    return numbers[0], numbers[1] if len(numbers) > 1 else (0.0,) * axes


def _own(given: Mapping[str, Any]) -> tuple[Floats | None, dict[str, str], dict[str, list[int]]]:
    """Direction, metadata and chunks that accelsurf has written."""
    direction = None if "direction" not in given else np.array(given["direction"], np.float64)
    if direction is not None and direction.shape != (3, 3):
        raise ValueError("the direction is no matrix of 3 x 3")
    metadata = {
        str(key): str(value)
        for key, value in given.get("metadata", {}).items()
        if key != WARNING_KEY
    }
    stored = {
        str(path): [int(edge) for edge in edges]
        for path, edges in given.get(STORED_KEY, {}).items()
    }
    return direction, metadata, stored


def _mm_per_unit(unit: str) -> float:
    """Millimetres of a unit; of none, 1."""
    mm = mm_of(unit) if unit else 1.0
    if not mm:
        raise InputError(
            f"the OME-Zarr gives lengths in {unit[:40]}, a unit of length expected",
            "correct the unit",
        )
    return mm


def _space_axes(axes: Sequence[OmeAxis]) -> tuple[int, ...]:
    found = [i for i, axis in enumerate(axes) if axis.kind == "space"]
    names = [axes[i].name.lower() for i in found]
    wanted = ("z", "y", "x")[3 - len(found) :]
    return (
        tuple(found[names.index(name)] for name in wanted)
        if set(names) == set(wanted)
        else tuple(found)
    )


def _placed(
    axes: Sequence[OmeAxis], finest: OmeLevel, stored: Floats | None, metadata: dict[str, str]
) -> tuple[Floats, dict[str, str]]:
    """The directions of the axes, and the metadata with warnings about them."""
    order = _space_axes(axes)[::-1]
    words, notes = [axes[i].orientation for i in order], []
    direction = direction_of(words)
    if direction is None and any(words):
        named = ", ".join(f"{axes[i].name[:40]}: {axes[i].orientation or 'none'}" for i in order)
        notes.append(
            f"the orientations of the axes ({named}) are not lines of the body, as in RFC-4, and not used"
        )
    if stored is not None:
        if direction is not None and not np.allclose(direction, stored, rtol=0.0, atol=1e-4):
            raise InputError(
                'the orientation of the axes of the OME-Zarr contradicts "direction" in its attribute "accelsurf"',
                'remove what is wrong: "orientation" of the axes, or "direction" of "accelsurf"',
            )
        return stored, with_warnings(metadata, *notes)
    if direction is None:
        return np.eye(3), with_warnings(metadata, *notes)
    if not np.array_equal(direction, np.eye(3)) and any(finest.translation[i] for i in order):
        notes.append(
            "the axes are oriented and the store has a translation: it is read as the place of the first voxel in LPS, "
            "as ngff-zarr writes it; if the image lies elsewhere, correct the translation"
        )
    return direction, with_warnings(metadata | {ORIENTED_KEY: "yes"}, *notes)


def word_of(axis: Mapping[str, Any]) -> str:
    """The orientation that an axis says it has; empty where it says none.

    Examples
    --------
    >>> word_of({"name": "x", "orientation": {"type": "anatomical", "value": "left-to-right"}})
    'left-to-right'
    """
    said = axis.get("orientation") or ""
    return str(said.get("value", "") if isinstance(said, Mapping) else said)[:80]


def direction_of(words: Sequence[str]) -> Floats | None:
    """The directions of a grid by the orientations of its axes x, y and z, or x and y, in the words of RFC-4.

    Returns
    -------
    ndarray (3, 3) or None
        None where they do not name two or three different lines of the body.
    """
    ends = [tuple(word.split("-to-")) for word in words]
    found = [
        (axis, 1.0 if pair == sides else -1.0)
        for pair in ends
        for axis, sides in enumerate(_SIDES)
        if pair in (sides, sides[::-1])
    ]
    if len({axis for axis, _ in found}) < len(words):
        return None
    direction = np.zeros((3, 3))
    for column, (axis, sign) in enumerate(found):
        direction[axis, column] = sign
    if len(words) == 2:  # the slice is seen from the side that makes the axes right-handed
        direction[:, 2] = np.cross(direction[:, 0], direction[:, 1])
    return direction


def attributes_of(
    geometry: Geometry,
    levels: Sequence[tuple[str, Sequence[float], Sequence[float]]],
    metadata: Mapping[str, str],
    name: str,
    method: str,
) -> dict[str, Any]:
    """The attributes of the group of an image, version 0.5.

    Parameters
    ----------
    geometry : Geometry
        Of the finest level.
    levels : sequence of (path, spacing, offset)
        Spacing (z, y, x) in mm, and of the first voxel's centre from that of the finest level, along the axes.
    metadata : mapping of str to str
        As in `Volume`.
    name : str
        Of the image.
    method : str
        How the coarser levels were made.
    """
    first = geometry.origin[::-1]
    datasets = [
        {
            "path": path,
            "coordinateTransformations": [
                {"type": "scale", "scale": [float(h) for h in spacing]},
                {
                    "type": "translation",
                    "translation": [float(o + d) for o, d in zip(first, offset, strict=True)],
                },
            ],
        }
        for path, spacing, offset in levels
    ]
    axes: list[dict[str, Any]] = [
        {"name": axis, "type": "space", "unit": "millimeter"} for axis in "zyx"
    ]
    if (words := _words(geometry, metadata)) is not None:
        said = ({"orientation": {"type": "anatomical", "value": word}} for word in words)
        axes = [axis | orientation for axis, orientation in zip(axes, said, strict=True)]
    multiscale = {"name": name, "axes": axes, "datasets": datasets, "type": method}
    grid = {
        "direction": geometry.direction.tolist(),
        "metadata": {key: value for key, value in metadata.items() if key != WARNING_KEY},
    }
    return {"ome": {"version": VERSIONS[-1], "multiscales": [multiscale]}, OWN_KEY: grid}


def _words(geometry: Geometry, metadata: Mapping[str, str]) -> list[str] | None:
    """The orientation of the axes z, y and x that is written; None where nothing is said.

    The world is a patient's. Only where the lengths have a microscope's unit, and nothing says that the axes have a
    meaning, is it not said: the cells of a dish have no left side.
    """
    is_dish = (
        metadata.get(UNIT_KEY, "mm") != "mm"
        and not is_anatomical(metadata)
        and np.array_equal(geometry.direction, np.eye(3))
    )
    words = None if is_dish else words_for(geometry.direction)
    return None if words is None else words[::-1]


def words_for(direction: Floats) -> list[str] | None:
    """The words for the axes x, y and z of a grid; None where it is oblique.

    Examples
    --------
    >>> words_for(np.diag([-1.0, -1.0, 1.0]))
    ['left-to-right', 'posterior-to-anterior', 'inferior-to-superior']
    """
    if not np.isin(direction, (-1.0, 0.0, 1.0)).all():
        return None
    axes = np.abs(direction).argmax(axis=0)
    return [
        "-to-".join(_SIDES[axis] if direction[axis, column] > 0 else _SIDES[axis][::-1])
        for column, axis in enumerate(axes)
    ]
