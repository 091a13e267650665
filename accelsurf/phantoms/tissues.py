"""Sequences of speckled tissue with exact truth: a beating shell, a wall between two cavities, a cell that deforms.

Every frame is the same material, moved by a smooth map that is known in closed form. Scatterers lie in the material and
go with it; a frame is the magnitude of their blurred sum, which is speckle as ultrasound has it. Of the scatterers a
part is new in each frame: speckle that is seen from frame to frame only in part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import ndimage

from accelsurf.grid.arrays import Floats
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.phantoms.motions import MovingPhantom, SequenceRecipe, TruthRow, motion_from
from accelsurf.phantoms.recipe_files import checked
from accelsurf.phantoms.recipes import NotNegative, Positive, Real, centred_axis

Tissue = Literal["shell", "wall", "cell"]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
#: Half axes of the shell over its radius, x, y, z; it is open above this part of its height.
SHELL_AXES = (0.85, 0.85, 1.15)
SHELL_OPEN = 0.55
#: Angle by which a shell twists at its ends at the top of a beat; lobes of a cell.
TWIST = 0.15
LOBES = 3
#: Voxels beyond the grid from which scatterers may come in.
AROUND = 24


class Material(NamedTuple):
    """The material at the voxels of a frame: ``place`` (3, nz, ny, nx), where each was at rest, x y z mm from the
    middle; ``labels`` (nz, ny, nx), of the objects; ``bright`` (nz, ny, nx), True in tissue with the value ``inside``.
    """

    place: Floats
    labels: NDArray[np.uint8]
    bright: NDArray[np.bool_]


class TissueRecipe(SequenceRecipe):
    """Recipe of a phantom of tissue in time: a `SequenceRecipe` with the tissue that moves. Its radius is the chamber's
    or the cell's at rest, on the outside.

    Attributes
    ----------
    tissue : str
        shell (object 1 is the wall of a chamber that beats and twists), wall (objects 1 and 2 are dark cavities with a
        wall between them that swings) or cell (object 1 is a cell whose lobes go round).
    thickness : float
        Of the wall.
    amplitude : float
        Way that the wall goes to either side at most, or height of the lobes.
    period : float
        Frames of a beat, a swing or a third of a turn.
    travel : (x, y, z)
        Way of the whole in a frame.
    inside, outside : float
        Mean values: of wall or cell, and of cavities and surroundings.
    speckle : float
        From 0, none, to 1, fully developed.
    coherence : float
        Part of the power of the scatterers that goes with the material; the others are new in each frame.
    grain : float
        Standard deviation of the blur.
    """

    tissue: Tissue
    frames: Annotated[int, Field(strict=True, ge=2, le=10_000)] = 7
    thickness: Positive = 6.0
    amplitude: NotNegative = 4.0
    period: Positive = 7.0
    travel: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    inside: Positive = 137.0
    outside: Positive = 85.0
    speckle: Share = 1.0
    coherence: Share = 0.5
    grain: Positive = 1.0

    @model_validator(mode="after")
    def _checked(self) -> TissueRecipe:
        if self.thickness + self.amplitude >= self.radius:
            raise ValueError(
                "thickness and amplitude given, together less than the radius expected"
            )
        return self

    def material(self, time: float) -> Material:
        """The material at a time, in frames from the first."""
        centred = [centred_axis(n, h) for n, h in zip(self.shape, self.spacing, strict=True)]
        axes = [axis - way * time for axis, way in zip(centred, self.travel, strict=True)]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        return _TISSUES[self.tissue](self, np.stack((x, y, z)), time)


def _shell(recipe: TissueRecipe, now: Floats, time: float) -> Material:
    # The tissue keeps its volume: r^3 - R^3 is the same everywhere, along the half axes.
    axes = np.array(SHELL_AXES)[:, None, None, None]
    part = 0.5 - 0.5 * math.cos(2.0 * math.pi * time / recipe.period)
    inner = recipe.radius - recipe.thickness
    more = (inner - recipe.amplitude * part) ** 3 - inner**3
    scaled = now / axes
    radius = np.sqrt((scaled**2).sum(axis=0))
    at_rest = np.cbrt(np.maximum(radius**3 - more, 0.0))
    place = scaled * (at_rest / np.maximum(radius, 1e-9))
    angle = TWIST * part * place[2] / recipe.radius
    cos, sin = np.cos(angle), np.sin(angle)
    place = (
        np.stack((cos * place[0] + sin * place[1], cos * place[1] - sin * place[0], place[2]))
        * axes
    )
    wall = (
        (at_rest > inner)
        & (at_rest <= recipe.radius)
        & (place[2] < SHELL_OPEN * axes[2] * recipe.radius)
    )
    return Material(place, wall.astype(np.uint8), wall)


def _wall(recipe: TissueRecipe, now: Floats, time: float) -> Material:
    part = math.sin(2.0 * math.pi * time / recipe.period)
    free = np.maximum(1.0 - (now[1] ** 2 + now[2] ** 2) / recipe.radius**2, 0.0)
    place = now.copy()
    place[0] -= recipe.amplitude * part * free
    chamber = (now**2).sum(axis=0) < recipe.radius**2
    wall = np.abs(place[0]) <= 0.5 * recipe.thickness
    labels = np.where(chamber & ~wall, np.where(place[0] < 0, 1, 2), 0).astype(np.uint8)
    return Material(place, labels, labels == 0)


def _cell(recipe: TissueRecipe, now: Floats, time: float) -> Material:
    flat = recipe.shape[2] == 1
    turned = np.arctan2(now[1], now[0]) * LOBES + 2.0 * math.pi * time / recipe.period
    radius = np.sqrt((now**2).sum(axis=0))
    across = 1.0 if flat else np.hypot(now[0], now[1]) / np.maximum(radius, 1e-9)
    place = now / (1.0 + recipe.amplitude / recipe.radius * np.cos(turned) * across**2)
    cell = (place**2).sum(axis=0) < recipe.radius**2
    return Material(place, cell.astype(np.uint8), cell)


_TISSUES: dict[str, Callable[[TissueRecipe, Floats, float], Material]] = {
    "shell": _shell,
    "wall": _wall,
    "cell": _cell,
}
assert set(_TISSUES) == set(get_args(Tissue))


class TissuePhantom(ImageSequence):
    """A sequence made of a recipe, frame by frame; the same recipe gives the same bytes.

    Parameters
    ----------
    recipe : TissueRecipe
    """

    def __init__(self, recipe: TissueRecipe) -> None:
        self.recipe = recipe
        self.geometry = recipe.geometry
        self.source = recipe.name
        self.times, self.time_unit = recipe.times, recipe.time_unit

    def _channels(self, number: int) -> list[Volume]:
        recipe, material = self.recipe, self.recipe.material(number)
        strength = np.where(material.bright, recipe.inside, recipe.outside)
        spacing = self.geometry.spacing
        sigma = [
            recipe.grain / h if n > 1 else 0.0 for h, n in zip(spacing, strength.shape, strict=True)
        ]
        smooth = ndimage.gaussian_filter(strength, sigma, mode="nearest")
        values = (1.0 - recipe.speckle) * smooth
        if recipe.speckle:
            values = values + recipe.speckle * self._speckle(number, material, strength, sigma)
        return [Volume(values.astype(np.float32), self.geometry)]

    def _speckle(
        self, number: int, material: Material, strength: Floats, sigma: list[float]
    ) -> Floats:
        """Magnitude of the blurred sum of scatterers, with the mean that it has without speckle."""
        recipe, shape = self.recipe, np.array(strength.shape)
        wide = np.where(shape > 1, shape + 2 * AROUND, 1)
        lasting, new = (
            np.random.Generator(np.random.PCG64([recipe.seed, stream]))
            for stream in (0, 1 + number)
        )
        index = material.place[::-1] / np.array(self.geometry.spacing)[:, None, None, None]
        nearest = np.rint(index + ((wide - 1) / 2)[:, None, None, None]).astype(np.int64)
        nearest = np.clip(nearest, 0, (wide - 1)[:, None, None, None])
        sums = []
        for _ in range(2):  # of the real and of the imaginary part
            moved = lasting.standard_normal(tuple(wide))[tuple(nearest)]
            fresh = new.standard_normal(tuple(shape))
            field = strength * (
                math.sqrt(recipe.coherence) * moved + math.sqrt(1.0 - recipe.coherence) * fresh
            )
            sums.append(ndimage.gaussian_filter(field, sigma, mode="nearest"))
        single = np.zeros(np.where(shape > 1, 2 * AROUND + 1, 1))
        single[tuple(np.array(single.shape) // 2)] = 1.0
        power = float((ndimage.gaussian_filter(single, sigma) ** 2).sum())
        return np.hypot(*sums) / math.sqrt(power * math.pi / 2.0)

    def truth(self, number: int) -> NDArray[np.uint8]:
        """Labels (nz, ny, nx) of a frame."""
        return self.recipe.material(number).labels

    def rows(self) -> list[TruthRow]:
        """The objects of all frames, with the centre and volume of their voxels."""
        rows = []
        for number, time in enumerate(self.times):
            labels = self.truth(number)
            for id in (1, 2) if self.recipe.tissue == "wall" else (1,):
                index = np.argwhere(labels == id)
                shown = bool(len(index))
                place = self.geometry.index_to_world(index.mean(axis=0)) if shown else np.zeros(3)
                center = float(place[0]), float(place[1]), float(place[2])
                volume = len(index) * self.geometry.voxel_volume
                rows.append(TruthRow(number, time, id, 0, center, volume, shown))
        return rows


def phantom_from(values: Mapping[str, Any], where: str = "recipe") -> MovingPhantom | TissuePhantom:
    """A phantom in time of a recipe's keys and values, with ``tissue`` or ``motion``.

    Raises
    ------
    UsageError
        When a key is unknown or a value is out of bounds.

    Examples
    --------
    >>> len(phantom_from({"tissue": "cell", "shape": [32, 32, 1], "radius": 8.0, "thickness": 1.0}))
    7
    """
    if "tissue" in values:
        return TissuePhantom(checked(TissueRecipe, values, where))
    return MovingPhantom(motion_from(values, where))
