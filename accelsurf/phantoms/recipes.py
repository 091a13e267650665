"""Synthetic volumes with exact truth: recipes in TOML, seeded, the same recipe gives the same bytes.

An object is placed in mm relative to the middle of the volume, its axes along the index axes x, y, z; the direction
matrix turns volume and object together, so an oblique phantom is the same object on a turned grid. The middle of the
volume is the world's origin (0, 0, 0).

The image is plain: background + contrast where a voxel's centre lies inside the object; then Gaussian blur in mm,
a smooth multiplicative bias field, and Gaussian noise for each voxel, in this order. With ``antialias`` the voxels that
the surface passes have the value of their volume fraction inside (4 x 4 x 4 sample points): only then does the image
show where in the voxel the surface is. The truth label is that of the voxel's centre in both cases.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from accelsurf.errors import UsageError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import slabs
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.phantoms.recipe_files import checked, read_recipe
from accelsurf.phantoms.solids import SOLIDS, Ellipsoid, Solid

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Seed = Annotated[int, Field(strict=True, ge=0)]

MAX_VOXELS = 2**30
"""Largest phantom: beyond it image, truth and temporary arrays need more than 10 GB."""

_OBJECT_KEYS = {key for solid in SOLIDS.values() for key in inspect.signature(solid).parameters}


class Neighbour(BaseModel):
    """An ellipsoid beside the object, in the image and not in the truth.

    Attributes
    ----------
    half_axes, center : triple
        As of the object; mm, in the order x, y, z.
    value : float
        Value inside.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    half_axes: tuple[Positive, Positive, Positive]
    center: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    value: Real


class Recipe(BaseModel):
    """Recipe of a phantom. Lengths in mm; triples in the order x, y, z.

    ``Recipe(...)`` raises pydantic's ValidationError; `load_recipe` and `recipe_from` raise UsageError instead.

    Attributes
    ----------
    kind : {"ball", "ellipsoid", "cube", "box", "torus", "two-balls", "vessel"}
        The object. Its own parameters: ball: radius. ellipsoid: half_axes. cube: side. box: sides. torus:
        ring_radius, tube_radius. two-balls: radius, gap (0). vessel: radius and length of the root, levels (4),
        angle (35), taper (0.85), tree_seed (none: a regular tree). A parameter of another kind is refused.
    name : str
        Stem of the files made from it; by default the recipe file's.
    shape, spacing : triple
        Number of voxels and their size; spacing 1 by default.
    center : triple
        Middle of the object relative to the volume's, along the index axes.
    rotation : triple
        Degrees by which the index axes are turned about the world's x, then y, then z axis.
    background, contrast : float
        Value outside, and the increase inside; 0 and 1.
    around : sequence of Neighbour
        Ellipsoids around the object, each over those before it; the object lies over all. None by default.
    antialias : bool
        Whether voxels that the surface passes have the value of their volume fraction inside; false.
    blur : float
        Standard deviation of the Gaussian blur, mm; 0.
    bias : float
        Relative amplitude of the bias field, at least 0 and less than 1: the image is multiplied by 1 + bias f, with
        f smooth (half a wave across the volume along each axis, phases from the seed) and between -1 and 1; 0.
    noise : float
        Standard deviation of the noise; 0.
    seed : int
        Of noise and bias phases; 0.

    Examples
    --------
    >>> recipe = Recipe(kind="ball", shape=(32, 32, 32), radius=10)
    >>> phantom = make(recipe)
    >>> round(phantom.volume_mm3), int(phantom.truth.array.sum())
    (4189, 4224)
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["ball", "ellipsoid", "cube", "box", "torus", "two-balls", "vessel"]
    name: Annotated[str, Field(pattern=r"^[^./\\][^/\\]*$")] = "phantom"
    shape: tuple[Count, Count, Count]
    spacing: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    center: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    rotation: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    radius: Positive | None = None
    half_axes: tuple[Positive, Positive, Positive] | None = None
    side: Positive | None = None
    sides: tuple[Positive, Positive, Positive] | None = None
    ring_radius: Positive | None = None
    tube_radius: Positive | None = None
    gap: NotNegative | None = None
    length: Positive | None = None
    levels: Annotated[int, Field(strict=True, ge=1, le=8)] | None = None
    angle: Annotated[float, Field(strict=True, gt=0.0, lt=90.0)] | None = None
    taper: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] | None = None
    tree_seed: Seed | None = None
    background: Real = 0.0
    contrast: Real = 1.0
    around: tuple[Neighbour, ...] = ()
    antialias: Annotated[bool, Field(strict=True)] = False
    blur: NotNegative = 0.0
    bias: Annotated[float, Field(strict=True, ge=0.0, lt=1.0)] = 0.0
    noise: NotNegative = 0.0
    seed: Seed = 0

    @model_validator(mode="after")
    def _checked(self) -> Recipe:
        known = inspect.signature(SOLIDS[self.kind]).parameters
        foreign = sorted(key for key in _OBJECT_KEYS - set(known) if getattr(self, key) is not None)
        missing = [
            key for key, p in known.items() if p.default is p.empty and getattr(self, key) is None
        ]
        if foreign:
            raise ValueError(
                f"{foreign[0]} does not apply to a {self.kind}, which has {', '.join(known)}"
            )
        if missing:
            raise ValueError(f"{missing[0]} is missing; a {self.kind} has {', '.join(known)}")
        if self.contrast == 0.0:
            raise ValueError(
                "contrast 0 given, another number expected (there would be nothing to see)"
            )
        if math.prod(self.shape) > MAX_VOXELS:
            raise ValueError(f"shape {self.shape} given, at most {MAX_VOXELS} voxels expected")
        _ = self.solid  # its own checks
        return self

    @property
    def solid(self) -> Solid:
        """The object, around its own middle."""
        keys = inspect.signature(SOLIDS[self.kind]).parameters
        return SOLIDS[self.kind](
            **{key: getattr(self, key) for key in keys if getattr(self, key) is not None}
        )

    @property
    def geometry(self) -> Geometry:
        """The grid: its middle is the world's origin."""
        direction = np.eye(3)
        if any(self.rotation):
            # Not with the module: the viewer lists the recipes as it starts, and this loads half of SciPy.
            from scipy.spatial.transform import Rotation

            direction = Rotation.from_euler("xyz", self.rotation, degrees=True).as_matrix()
        corner = direction @ (-np.array(self.spacing) * (np.array(self.shape) - 1) / 2)
        nx, ny, nz = self.shape
        hx, hy, hz = self.spacing
        return Geometry((nz, ny, nx), (hz, hy, hx), tuple(corner), direction)

    def changed(self, **changes: Any) -> Recipe:
        """The same recipe with other values, checked like a new one: ``recipe.changed(seed=3)``.

        Raises
        ------
        UsageError
            When a key is unknown or a value impossible.
        """
        return recipe_from(self.model_dump(exclude_none=True) | changes, self.name)


@dataclass(frozen=True, eq=False)
class Phantom:
    """A synthetic volume and its exact measures.

    Attributes
    ----------
    image : Volume
        float32.
    truth : Volume
        uint8: 1 where the voxel's centre lies inside the object.
    volume_mm3, area_mm2 : float or None
        Of the object itself, exact; None for a vessel, and when the object reaches beyond the volume.
    recipe : Recipe
        Recipe that it was made from.
    """

    image: Volume
    truth: Volume
    volume_mm3: float | None
    area_mm2: float | None
    recipe: Recipe


def make(recipe: Recipe) -> Phantom:
    """Make a phantom; the same recipe gives the same bytes.

    Raises
    ------
    UsageError
        When no voxel centre lies inside the object.
    """
    geometry, solid = recipe.geometry, recipe.solid
    truth = np.empty(geometry.shape, dtype=np.uint8)
    image = np.empty(geometry.shape, dtype=np.float32)
    for planes, points in _voxel_centres(recipe):
        distance = solid.distance(*points)
        truth[planes] = distance < 0.0
        image[planes] = truth[planes]
        if recipe.antialias:
            _antialias(image[planes], distance, points, recipe)
    if not truth.any():
        raise UsageError(
            f"{recipe.name}: no voxel centre lies inside the object",
            hint="move it by center, or make it larger",
        )
    image = _among_neighbours(image, recipe)
    image = _degraded(image, recipe)
    half_volume = np.array(recipe.shape) * np.array(recipe.spacing) / 2
    whole = bool(
        (np.abs(recipe.center) + np.array(solid.half_extent) <= half_volume * (1 + 1e-9)).all()
    )
    return Phantom(
        image=Volume(image, geometry),
        truth=Volume(truth, geometry),
        volume_mm3=solid.volume if whole else None,
        area_mm2=solid.area if whole else None,
        recipe=recipe,
    )


def _among_neighbours(inside: NDArray[np.float32], recipe: Recipe) -> NDArray[np.float32]:
    """The image of the object and its neighbours, from the share of each voxel that is inside the object."""
    if not recipe.around:
        return inside * np.float32(recipe.contrast) + np.float32(recipe.background)
    image = np.full_like(inside, recipe.background)
    middle = np.array(recipe.center)
    for planes, points in _voxel_centres(recipe):
        for neighbour in recipe.around:
            away = neighbour.center - middle
            places = (point - shift for point, shift in zip(points, away, strict=True))
            solid = Ellipsoid(neighbour.half_axes)
            image[planes][solid.contains(*places)] = neighbour.value
    return image + inside * (np.float32(recipe.background + recipe.contrast) - image)


def signed_distance(recipe: Recipe) -> NDArray[np.float32]:
    """Signed distance to the object's surface at the voxel centres, mm, negative inside; shape (nz, ny, nx).

    Exact, but for a vessel's inside (see `accelsurf.phantoms.solids.Vessel`). The border of the volume is no surface.

    Examples
    --------
    >>> signed_distance(Recipe(kind="ball", shape=(3, 1, 1), radius=1.5)).ravel().tolist()
    [-0.5, -1.5, -0.5]
    """
    nx, ny, nz = recipe.shape
    psi = np.empty((nz, ny, nx), dtype=np.float32)
    for planes, points in _voxel_centres(recipe):
        psi[planes] = recipe.solid.distance(*points)
    return psi


def distance_at(recipe: Recipe, xyz: ArrayLike) -> Floats:
    """Signed distance to the object's surface at world positions, mm, negative inside.

    Parameters
    ----------
    recipe : Recipe
        The object and how it lies.
    xyz : array_like, shape (..., 3)
        World positions, mm LPS, e.g. the vertices of a surface.

    Returns
    -------
    ndarray, shape (...), float64

    Examples
    --------
    >>> distance_at(Recipe(kind="ball", shape=(8, 8, 8), radius=3), [[0, 0, 5], [0, 0, 0]])
    array([ 2., -3.])
    """
    local = np.asarray(xyz, dtype=np.float64) @ recipe.geometry.direction - np.array(recipe.center)
    return recipe.solid.distance(local[..., 0], local[..., 1], local[..., 2])


def centred_axis(count: int, spacing: float) -> Floats:
    """Return the voxel centres along an axis, (count,) mm from its middle."""
    return (np.arange(count, dtype=np.float64) - (count - 1) / 2) * spacing


def _voxel_centres(recipe: Recipe) -> Iterator[tuple[slice, tuple[Floats, Floats, Floats]]]:
    """Runs of slices, and their voxel centres relative to the object's middle, as arrays that broadcast to them."""
    centred = [centred_axis(n, h) for n, h in zip(recipe.shape, recipe.spacing, strict=True)]
    x, y, z = (axis - c for axis, c in zip(centred, recipe.center, strict=True))
    for planes in slabs((len(z), len(y), len(x))):
        yield planes, (x.reshape(1, 1, -1), y.reshape(1, -1, 1), z[planes].reshape(-1, 1, 1))


def _antialias(
    image: NDArray[np.float32], distance: Floats, points: tuple[Floats, ...], recipe: Recipe
) -> None:
    """Write the volume fraction inside of voxels that the surface may pass, from 4 x 4 x 4 sample points."""
    spacing = np.array(recipe.spacing)
    k, j, i = np.nonzero(np.abs(distance) < np.linalg.norm(spacing) / 2)
    offsets = (np.indices((4, 4, 4)).reshape(3, -1) - 1.5) / 4 * spacing[:, np.newaxis]
    near = (points[0].ravel()[i], points[1].ravel()[j], points[2].ravel()[k])
    samples = (p[:, np.newaxis] + offset for p, offset in zip(near, offsets, strict=True))
    image[k, j, i] = (recipe.solid.distance(*samples) < 0.0).mean(axis=1)


def _degraded(image: NDArray[np.float32], recipe: Recipe) -> NDArray[np.float32]:
    """The image with blur, bias and noise; the array given may be overwritten."""
    if recipe.blur:
        # Not with the module: the viewer lists the recipes as it starts, and this loads the compiler.
        from accelsurf.image.smoothing import gaussian_mm

        image = gaussian_mm(image, recipe.spacing[::-1], recipe.blur)
    if recipe.bias:
        # Its own stream: the same noise with and without a bias field.
        phases = np.random.Generator(np.random.PCG64([recipe.seed, 1])).uniform(
            0.0, 2.0 * math.pi, 3
        )
        angles = [math.pi * (np.arange(n) + 0.5) / n for n in recipe.shape]
        x, y, z = (np.sin(angle + phase) for angle, phase in zip(angles, phases, strict=True))
        field = (x.reshape(1, 1, -1) + y.reshape(1, -1, 1) + z.reshape(-1, 1, 1)) / 3
        image *= (1.0 + recipe.bias * field).astype(np.float32)
    if recipe.noise:
        random = np.random.Generator(np.random.PCG64(recipe.seed))
        image += np.float32(recipe.noise) * random.standard_normal(image.shape, dtype=np.float32)
    return image


def load_recipe(recipe: str | Path, *, seed: int | None = None) -> Recipe:
    """Read a recipe: a TOML file, or by its bare name one that comes with accelsurf; with another seed, if given.

    Raises
    ------
    InputError
        When the file cannot be read or is not TOML.
    UsageError
        When no recipe has this name, a key is unknown, or a value impossible; the message names the key.

    Examples
    --------
    >>> load_recipe("cube_noisy").side
    48.0
    """
    path, values = read_recipe(recipe)
    return recipe_from(values if seed is None else {**values, "seed": seed}, str(path))


def phantom(recipe: str | Path, *, seed: int | None = None) -> Phantom:
    """Make the phantom of a recipe: its ``image`` and its ``truth``, which are volumes.

    Parameters
    ----------
    recipe : str or Path
        A TOML file, or the name of a recipe that comes with accelsurf; ``accelsurf info recipes`` lists them.
    seed : int, optional
        Of noise and bias; the recipe's by default.

    Raises
    ------
    InputError, UsageError
        As `load_recipe`.

    Examples
    --------
    >>> made = phantom("ball_small")
    >>> made.image.geometry.shape == made.truth.array.shape
    True
    """
    return make(load_recipe(recipe, seed=seed))


def recipe_from(values: Mapping[str, Any], where: str = "recipe") -> Recipe:
    """A recipe from its keys and values.

    Parameters
    ----------
    values : mapping
        As in the TOML file.
    where : str, optional
        Beginning of error messages.

    Raises
    ------
    UsageError
        When a key is unknown or missing, or a value impossible; the message names the key.
    """
    return checked(Recipe, values, where)
