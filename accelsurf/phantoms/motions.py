"""Sequences with exact truth: bodies that move, turn, deform, beat, divide, pass, bounce, leave and come back.

A body at a time is an ellipsoid c + M u, |u| < 1: its volume 4/3 pi det M and its centroid c are exact. The middle of
the volume is the world's origin; the middle of the motion is the middle frame. A voxel has the value of its volume
fraction inside (3 x 3 x 3 sample points), times the contrast, over the background; noise is drawn for each frame by its
own number, so that a frame is the same whether it is made alone or among all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.phantoms.recipe_files import checked, read_recipe
from accelsurf.phantoms.recipes import (
    MAX_VOXELS,
    Count,
    NotNegative,
    Positive,
    Real,
    Seed,
    centred_axis,
)

Motion = Literal[
    "translation",
    "acceleration",
    "rotation",
    "deformation",
    "beat",
    "division",
    "passing",
    "bounce",
    "return",
]
#: Sample points of a voxel along each axis.
SAMPLES = 3
#: Axes of a body that turns, over its radius.
TURNING = (1.4, 0.8, 0.8)
#: Part of the radius by which a beating body swells and shrinks; most that a deforming one is stretched.
BEAT = 0.2
STRETCH = 1.6
#: Gap between bodies that pass, in voxels.
GAP = 2.0


class Body(NamedTuple):
    """An ellipsoid at a time: ``id``; ``center`` (x, y, z), mm; ``matrix`` (3, 3), x y z, det > 0, mm."""

    id: int
    center: Floats
    matrix: Floats

    @property
    def volume_mm3(self) -> float:
        """Volume, with the part beyond the image."""
        return 4.0 / 3.0 * math.pi * float(np.linalg.det(self.matrix))


class SequenceRecipe(BaseModel):
    """Fields of the recipes of all phantoms in time. Lengths in mm; triples in the order x, y, z.

    Attributes
    ----------
    name : str
    shape, spacing : triples
        Grid of every frame; its middle is the world's origin.
    frames : int
    frame_time : float or None
        Seconds between frames; None counts them.
    radius : float
    seed : int
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = ""
    shape: tuple[Count, Count, Count]
    spacing: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    frames: Annotated[int, Field(strict=True, ge=2, le=10_000)] = 11
    frame_time: Positive | None = None
    radius: Positive
    seed: Seed = 0

    @model_validator(mode="after")
    def _few_voxels(self) -> Self:
        if math.prod(self.shape) > MAX_VOXELS:
            raise ValueError(f"shape {self.shape} given, at most {MAX_VOXELS} voxels expected")
        return self

    @property
    def geometry(self) -> Geometry:
        """Grid of the frames."""
        nx, ny, nz = self.shape
        hx, hy, hz = self.spacing
        corner = (-hx * (nx - 1) / 2, -hy * (ny - 1) / 2, -hz * (nz - 1) / 2)
        return Geometry((nz, ny, nx), (hz, hy, hx), corner)

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the frames."""
        return tuple((self.frame_time or 1.0) * n for n in range(self.frames))

    @property
    def time_unit(self) -> str:
        """Unit of the times."""
        return "s" if self.frame_time else "frame"


class MotionRecipe(SequenceRecipe):
    """Recipe of a moving phantom: of a `SequenceRecipe`, and of its bodies.

    Attributes
    ----------
    motion : str
        translation, acceleration, rotation, deformation, beat, division, passing, bounce or return; in one slice (z =
        1) a disc moves in its plane.
    speed : float
        Radii in ten frames: of the translation; mean of the acceleration, which begins at rest; of the pieces of a
        division away from each other; of each of two bodies. For a rotation, turns in ten frames.
    direction : (x, y, z)
        Of the motion; need not have length 1.
    period : float
        Frames of a beat.
    background, contrast, noise, drift : float
        Values; drift is the part of the contrast that is lost in ten frames.
    empty : tuple of int
        Frames that show nothing but the background.
    """

    motion: Motion
    speed: NotNegative = 1.0
    direction: tuple[Real, Real, Real] = (1.0, 0.0, 0.0)
    period: Positive = 10.0
    background: Real = 0.0
    contrast: Real = 1.0
    noise: NotNegative = 0.0
    drift: Real = 0.0
    empty: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = ()

    @model_validator(mode="after")
    def _checked(self) -> MotionRecipe:
        if self.contrast == 0.0:
            raise ValueError(
                "contrast 0 given, another number expected (there would be nothing to see)"
            )
        if not any(self.direction):
            raise ValueError("direction 0, 0, 0 given, one that points somewhere expected")
        if beyond := [frame for frame in self.empty if frame >= self.frames]:
            raise ValueError(f"empty: frame {beyond[0]} given, expected 0 to {self.frames - 1}")
        return self

    @property
    def is_flat(self) -> bool:
        """True if the frames are single slices."""
        return self.shape[2] == 1

    def bodies(self, time: float) -> list[Body]:
        """The bodies at a time, in frames from the first."""
        return _MOTIONS[self.motion](self, time)

    @property
    def way(self) -> Floats:
        """The direction, of length 1."""
        way = np.array(self.direction, np.float64)
        return way / np.linalg.norm(way)

    @property
    def step(self) -> float:
        """Way in a frame at the recipe's speed, mm."""
        return self.speed * self.radius / 10.0

    @property
    def divides_at(self) -> float | None:
        """The time at which a dividing body has become two that touch; None for other motions."""
        return 0.4 * (self.frames - 1) if self.motion == "division" else None


def _ball(recipe: MotionRecipe, center: Floats, id: int = 1, radius: float | None = None) -> Body:
    return Body(id, center, (recipe.radius if radius is None else radius) * np.eye(3))


def _since_middle(recipe: MotionRecipe, time: float) -> float:
    return time - 0.5 * (recipe.frames - 1)


def _translation(recipe: MotionRecipe, time: float) -> list[Body]:
    return [_ball(recipe, recipe.way * recipe.step * _since_middle(recipe, time))]


def _acceleration(recipe: MotionRecipe, time: float) -> list[Body]:
    last = recipe.frames - 1
    return [_ball(recipe, recipe.way * recipe.step * last * ((time / last) ** 2 - 0.5))]


def _rotation(recipe: MotionRecipe, time: float) -> list[Body]:
    angle = 2.0 * math.pi * recipe.speed / 10.0 * time
    cos, sin = math.cos(angle), math.sin(angle)
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return [Body(1, np.zeros(3), turned @ np.diag(TURNING) * recipe.radius)]


def _deformation(recipe: MotionRecipe, time: float) -> list[Body]:
    # A stretch along x that leaves the volume (of a disc, the area) as it is.
    stretch = STRETCH ** (2.0 * time / (recipe.frames - 1) - 1.0)
    across = stretch ** (-1.0 if recipe.is_flat else -0.5)
    return [
        Body(
            1,
            np.zeros(3),
            recipe.radius * np.diag([stretch, across, 1.0 if recipe.is_flat else across]),
        )
    ]


def _beat(recipe: MotionRecipe, time: float) -> list[Body]:
    factor = 1.0 + BEAT * math.sin(2.0 * math.pi * time / recipe.period)
    return [_ball(recipe, np.zeros(3), radius=recipe.radius * factor)]


def _division(recipe: MotionRecipe, time: float) -> list[Body]:
    at = recipe.divides_at
    assert at is not None  # it is a division
    small = recipe.radius * 2.0 ** (-1.0 / (2.0 if recipe.is_flat else 3.0))
    if time < at:
        return [_ball(recipe, np.zeros(3))]
    # From touching they go apart.
    apart = recipe.way * (small + 0.5 * recipe.step * (time - at) + 0.5 * GAP * max(recipe.spacing))
    return [_ball(recipe, -apart, 2, small), _ball(recipe, apart, 3, small)]


def _passing(recipe: MotionRecipe, time: float) -> list[Body]:
    along = recipe.way * recipe.step * _since_middle(recipe, time)
    beside = (
        np.cross(recipe.way, [0.0, 0.0, 1.0])
        if abs(recipe.way[2]) < 0.9
        else np.array([0.0, 1.0, 0.0])
    )
    beside = beside / np.linalg.norm(beside) * (recipe.radius + 0.5 * GAP * max(recipe.spacing))
    return [_ball(recipe, along + beside, 1), _ball(recipe, -along - beside, 2)]


def _bounce(recipe: MotionRecipe, time: float) -> list[Body]:
    # They touch in the middle frame, and turn back.
    apart = recipe.way * (recipe.radius + recipe.step * abs(_since_middle(recipe, time)))
    return [_ball(recipe, -apart, 1), _ball(recipe, apart, 2)]


def _return(recipe: MotionRecipe, time: float) -> list[Body]:
    # Beyond the border in the middle of the time by more than the radius, inside by more at both ends.
    half = 0.5 * np.array(recipe.shape) * np.array(recipe.spacing)
    edge = float(np.min(half[np.abs(recipe.way) > 0] / np.abs(recipe.way[np.abs(recipe.way) > 0])))
    place = edge + 1.5 * recipe.radius - recipe.step * abs(_since_middle(recipe, time))
    return [_ball(recipe, recipe.way * place)]


_MOTIONS: dict[str, Callable[[MotionRecipe, float], list[Body]]] = {
    "translation": _translation,
    "acceleration": _acceleration,
    "rotation": _rotation,
    "deformation": _deformation,
    "beat": _beat,
    "division": _division,
    "passing": _passing,
    "bounce": _bounce,
    "return": _return,
}
assert set(_MOTIONS) == set(get_args(Motion))


@dataclass(frozen=True)
class TruthRow:
    """A body in a frame: ``shown`` where a voxel centre lies inside and the frame is not an empty one."""

    frame: int
    time: float
    id: int
    parent: int
    center: tuple[float, float, float]
    volume_mm3: float
    shown: bool


class MovingPhantom(ImageSequence):
    """A sequence made of a recipe, frame by frame; the same recipe gives the same bytes.

    Parameters
    ----------
    recipe : MotionRecipe
    """

    def __init__(self, recipe: MotionRecipe) -> None:
        self.recipe = recipe
        self.geometry = recipe.geometry
        self.source = recipe.name
        self.times, self.time_unit = recipe.times, recipe.time_unit

    def _channels(self, number: int) -> list[Volume]:
        recipe = self.recipe
        image = np.zeros(self.geometry.shape)
        if number not in recipe.empty:
            for body in recipe.bodies(number):
                np.maximum(image, self._share(body), out=image)
        values = recipe.background + recipe.contrast * (1.0 - recipe.drift * number / 10.0) * image
        if recipe.noise:
            random = np.random.Generator(np.random.PCG64([recipe.seed, number]))
            values += recipe.noise * random.standard_normal(values.shape)
        return [Volume(values.astype(np.float32), self.geometry)]

    def truth(self, number: int) -> NDArray[np.uint8]:
        """Labels (nz, ny, nx) of a frame: the id of the body in which a voxel's centre lies."""
        labels = np.zeros(self.geometry.shape, np.uint8)
        for body in self.recipe.bodies(number):
            labels[self._is_inside(body, np.zeros(3))] = body.id
        return labels

    def rows(self) -> list[TruthRow]:
        """The bodies of all frames."""
        rows = []
        for number, time in enumerate(self.times):
            labels = self.truth(number)
            for body in self.recipe.bodies(number):
                shown = number not in self.recipe.empty and bool((labels == body.id).any())
                x, y, z = (float(v) for v in body.center)
                parent = 1 if body.id > 1 and self.recipe.motion == "division" else 0
                rows.append(
                    TruthRow(number, time, body.id, parent, (x, y, z), self._volume(body), shown)
                )
        return rows

    def _volume(self, body: Body) -> float:
        if not self.recipe.is_flat:
            return body.volume_mm3
        return math.pi * float(np.linalg.det(body.matrix[:2, :2])) * self.recipe.spacing[2]

    def _share(self, body: Body) -> Floats:
        """Volume fraction of each voxel inside a body."""
        places = (np.arange(SAMPLES) - 0.5 * (SAMPLES - 1)) / SAMPLES
        depths = [0.0] if self.recipe.is_flat else places.tolist()
        grid = itertools.product(places.tolist(), places.tolist(), depths)
        offsets = [np.array(place) * self.recipe.spacing for place in grid]
        inverse = np.linalg.inv(body.matrix)
        reach = max(float(np.linalg.norm(inverse @ offset)) for offset in offsets) + 1e-9
        size = np.sqrt(self._size(body, np.ix_(*reversed(self._axes(body, np.zeros(3))))[::-1]))
        share = (size < 1.0).astype(np.float64)
        # The points of other voxels are all inside or all outside, as their centre is.
        near = np.nonzero(np.abs(size - 1.0) <= reach)
        total = np.zeros(near[0].size)
        for offset in offsets:
            x, y, z = self._axes(body, offset)
            total += self._size(body, (x[near[2]], y[near[1]], z[near[0]])) < 1.0
        share[near] = total / len(offsets)
        return share

    def _is_inside(self, body: Body, offset: Floats) -> NDArray[np.bool_]:
        """Return True where the point ``offset`` (x, y, z) mm from a voxel's centre lies in a body."""
        return np.asarray(self._size(body, np.ix_(*reversed(self._axes(body, offset)))[::-1]) < 1.0)

    def _axes(self, body: Body, offset: Floats) -> tuple[Floats, ...]:
        """Coordinates x, y, z of points ``offset`` from the voxels' centres, from the body's centre on."""
        recipe = self.recipe
        centred = [centred_axis(n, h) for n, h in zip(recipe.shape, recipe.spacing, strict=True)]
        axes = [axis + o - c for axis, o, c in zip(centred, offset, body.center, strict=True)]
        if recipe.is_flat:
            axes[2] = np.zeros(1)
        return tuple(axes)

    @staticmethod
    def _size(body: Body, axes: tuple[Floats, ...]) -> Floats:
        """Square of the size, 1 for the body itself, of the body's like that goes through points x, y, z."""
        x, y, z = axes
        return np.asarray(
            sum((a * x + b * y + c * z) ** 2 for a, b, c in np.linalg.inv(body.matrix))
        )


def motion_from(values: Mapping[str, Any], where: str = "recipe") -> MotionRecipe:
    """A recipe from its keys and values; parameters and errors as `accelsurf.phantoms.recipes.recipe_from`."""
    return checked(MotionRecipe, values, where)


def load_motion(recipe: str | Path) -> MotionRecipe:
    """Read a recipe in time; parameter and errors as `accelsurf.phantoms.recipes.load_recipe`.

    Examples
    --------
    >>> load_motion("ball_moving").motion
    'translation'
    """
    path, values = read_recipe(recipe)
    return motion_from(values, str(path))
