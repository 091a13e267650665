"""Objects known exactly: signed distance everywhere, volume and area where a formula exists.

Phantoms are made of them, and tests measure against them. Coordinates are mm along x, y, z around the object's middle.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats

Triple = tuple[float, float, float]
#: Halvings of the interval of an ellipsoid's closest point: from a metre to below a nanometre.
_BISECTIONS = 50
_TREE_SPREAD = (np.array([0.7, 0.85, -0.5]), np.array([1.3, 1.15, 0.5]))


class Solid(ABC):
    """An object around (0, 0, 0), in mm along x, y, z."""

    @abstractmethod
    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Signed distance in mm, negative inside, at points given by arrays that broadcast together."""

    @property
    @abstractmethod
    def half_extent(self) -> Triple:
        """Half the edge lengths (x, y, z), mm, of the smallest box around the object."""

    @property
    def volume(self) -> float | None:
        """Exact volume in mm3; None where no formula is known."""
        return None

    @property
    def area(self) -> float | None:
        """Exact area in mm2; None where no formula is known."""
        return None


@dataclass(frozen=True)
class Ball(Solid):
    """All within ``radius``."""

    radius: float

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`."""
        return np.sqrt(x * x + y * y + z * z) - self.radius

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        return self.radius, self.radius, self.radius

    @property
    def volume(self) -> float:
        """4/3 pi r^3."""
        return 4.0 / 3.0 * math.pi * self.radius**3

    @property
    def area(self) -> float:
        """4 pi r^2."""
        return 4.0 * math.pi * self.radius**2


@dataclass(frozen=True)
class Ellipsoid(Solid):
    """Half axes of lengths ``half_axes`` (x, y, z)."""

    half_axes: Triple

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`.

        The closest point of p is h^2 p / (t + h^2) for the largest t at which it lies on the surface, found by
        bisection (Eberly, *Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid*, 2013). On the
        medial axis its coordinate along the shortest axis is 0 / 0, and follows from the others.
        """
        points = np.abs(np.stack(np.broadcast_arrays(x, y, z), axis=-1))
        order = np.argsort(self.half_axes)
        h, points = np.array(self.half_axes)[order], points[..., order]
        longer = h**2 - h[0] ** 2
        low, high = h[0] * points[..., 0], np.linalg.norm(h * points, axis=-1)  # of t + h[0]^2
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            with np.errstate(divide="ignore", invalid="ignore"):
                scaled = h * points / (middle[..., np.newaxis] + longer)
            beyond = (scaled**2).sum(axis=-1) > 1.0
            low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
        below = high[..., np.newaxis] + longer
        closest = np.divide(h**2 * points, below, out=np.zeros_like(points), where=below > 0.0)
        rest = 1.0 - ((closest[..., 1:] / h[1:]) ** 2).sum(axis=-1)
        on_axis = high < 1e-6 * h[0] ** 2
        closest[..., 0] = np.where(on_axis, h[0] * np.sqrt(np.maximum(rest, 0.0)), closest[..., 0])
        inside = self.contains(x, y, z)
        return np.where(inside, -1.0, 1.0) * np.linalg.norm(points - closest, axis=-1)

    def contains(self, x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
        """Tell which points lie inside, without their distance."""
        a, b, c = self.half_axes
        return (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 < 1.0

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        return self.half_axes

    @property
    def volume(self) -> float:
        """4/3 pi a b c."""
        return 4.0 / 3.0 * math.pi * math.prod(self.half_axes)

    @property
    def area(self) -> float:
        """4 pi R_G(a^2 b^2, a^2 c^2, b^2 c^2), with Carlson's integral (DLMF 19.33.1)."""
        # Not with the module: the viewer lists the recipes as it starts, and this loads a part of SciPy.
        from scipy.special import elliprg

        a, b, c = self.half_axes
        return float(4.0 * math.pi * elliprg((a * b) ** 2, (a * c) ** 2, (b * c) ** 2))


@dataclass(frozen=True)
class Cuboid(Solid):
    """Edges of lengths ``sides`` (x, y, z)."""

    sides: Triple

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`."""
        qx, qy, qz = (np.abs(p) - side / 2 for p, side in zip((x, y, z), self.sides, strict=True))
        inside = np.minimum(np.maximum(np.maximum(qx, qy), qz), 0.0)
        qx, qy, qz = (np.maximum(q, 0.0) for q in (qx, qy, qz))
        return inside + np.sqrt(qx * qx + qy * qy + qz * qz)

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        return self.sides[0] / 2, self.sides[1] / 2, self.sides[2] / 2

    @property
    def volume(self) -> float:
        """Product of the sides."""
        return math.prod(self.sides)

    @property
    def area(self) -> float:
        """Sum of the six faces."""
        a, b, c = self.sides
        return 2.0 * (a * b + b * c + c * a)


@dataclass(frozen=True)
class Torus(Solid):
    """A tube of radius ``tube_radius`` around a circle of radius ``ring_radius`` in the plane of x and y."""

    ring_radius: float
    tube_radius: float

    def __post_init__(self) -> None:
        if self.tube_radius >= self.ring_radius:
            raise ValueError(
                f"tube_radius {self.tube_radius:g} given, less than ring_radius expected (no hole is left)"
            )

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`."""
        return np.hypot(np.sqrt(x * x + y * y) - self.ring_radius, z) - self.tube_radius

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        outer = self.ring_radius + self.tube_radius
        return outer, outer, self.tube_radius

    @property
    def volume(self) -> float:
        """2 pi^2 R r^2."""
        return 2.0 * math.pi**2 * self.ring_radius * self.tube_radius**2

    @property
    def area(self) -> float:
        """4 pi^2 R r."""
        return 4.0 * math.pi**2 * self.ring_radius * self.tube_radius


@dataclass(frozen=True)
class TwoBalls(Solid):
    """Two equal balls side by side along x, their surfaces ``gap`` apart; 0: they touch in one point."""

    radius: float
    gap: float = 0.0

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`."""
        return Ball(self.radius).distance(np.abs(x) - self.radius - self.gap / 2, y, z)

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        return 2 * self.radius + self.gap / 2, self.radius, self.radius

    @property
    def volume(self) -> float:
        """Twice the ball's."""
        return 2.0 * Ball(self.radius).volume

    @property
    def area(self) -> float:
        """Twice the ball's."""
        return 2.0 * Ball(self.radius).area


@dataclass(frozen=True)
class Vessel(Solid):
    """A tree of tapering tubes with round ends; its root runs along z, each tube forks into two thinner ones.

    A child starts with the parent's end radius times 2^(-1/3) (Murray's law) and 0.85 of its length, ``angle`` degrees
    off its direction, in a plane perpendicular to that of the fork before. With ``tree_seed`` angles, lengths and
    planes vary. ``taper`` is the ratio of a tube's end radius to its start radius.

    The signed distance is the smallest of the tubes' exact ones: exact outside; inside it may fall short in depth
    where tubes meet. No formula gives volume and area.
    """

    radius: float
    length: float
    levels: int = 4
    angle: float = 35.0
    taper: float = 0.85
    tree_seed: int | None = None

    def __post_init__(self) -> None:
        if any(a - b >= np.linalg.norm(q - p) for p, q, a, b in self.tubes):
            raise ValueError(
                f"length {self.length:g} given, more expected: a tube tapers to nothing within its start"
            )

    @cached_property
    def tubes(self) -> list[tuple[Floats, Floats, float, float]]:
        """(start, end, start radius, end radius) of each, placed so that the box around all is centred."""
        random = (
            None if self.tree_seed is None else np.random.Generator(np.random.PCG64(self.tree_seed))
        )
        grown: list[tuple[Floats, Floats, float, float]] = []
        tips = [
            (
                np.zeros(3),
                np.array([0.0, 0.0, 1.0]),
                np.array([1.0, 0.0, 0.0]),
                self.radius,
                self.length,
            )
        ]
        for _ in range(self.levels):
            forked = []
            for start, along, aside, radius, length in tips:
                end, thin = start + length * along, radius * self.taper
                grown.append((start, end, radius, thin))
                for sign in (-1.0, 1.0):
                    turn, stretch, roll = (
                        (1.0, 1.0, 0.0) if random is None else random.uniform(*_TREE_SPREAD)
                    )
                    bend = sign * turn * math.radians(self.angle)
                    out = math.cos(bend) * along + math.sin(bend) * aside
                    side = np.cross(along, aside)
                    side = math.cos(roll) * side + math.sin(roll) * np.cross(out, side)
                    forked.append((end, out, side, thin * 0.5 ** (1 / 3), 0.85 * stretch * length))
            tips = forked
        low = np.min([np.minimum(p - a, q - b) for p, q, a, b in grown], axis=0)
        high = np.max([np.maximum(p + a, q + b) for p, q, a, b in grown], axis=0)
        middle = (low + high) / 2
        return [(p - middle, q - middle, a, b) for p, q, a, b in grown]

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """See `Solid.distance`."""
        nearest = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), np.inf)
        for start, end, first, last in self.tubes:
            tube = _round_cone(x - start[0], y - start[1], z - start[2], end - start, first, last)
            np.minimum(nearest, tube, out=nearest)
        return nearest

    @property
    def half_extent(self) -> Triple:
        """See `Solid.half_extent`."""
        high = np.max([np.maximum(p + a, q + b) for p, q, a, b in self.tubes], axis=0)
        return float(high[0]), float(high[1]), float(high[2])


"""Smallest and largest of: turn (times the angle), stretch (times the length), roll of the next fork (radians)."""


def _round_cone(x: Floats, y: Floats, z: Floats, axis: Floats, first: float, last: float) -> Floats:
    """Signed distance to the hull of two balls, at 0 and at ``axis``: that of the ball on the axis that is nearest.

    With s along the axis, q off it, balls of radius first - s sin(b): the nearest is centred at s - q tan(b).
    """
    length = float(np.linalg.norm(axis))
    sine = (first - last) / length
    s = (x * axis[0] + y * axis[1] + z * axis[2]) / length
    q = np.sqrt(np.maximum(x * x + y * y + z * z - s * s, 0.0))
    centre = np.clip(s - q * (sine / math.sqrt(1.0 - sine * sine)), 0.0, length)
    return np.hypot(s - centre, q) - (first - centre * sine)


def cube(side: float) -> Cuboid:
    """A cuboid with equal sides."""
    return Cuboid((side, side, side))


SOLIDS: dict[str, Callable[..., Solid]] = {
    "ball": Ball,
    "ellipsoid": Ellipsoid,
    "cube": cube,
    "box": Cuboid,
    "torus": Torus,
    "two-balls": TwoBalls,
    "vessel": Vessel,
}
"""What a recipe's ``kind`` may be; the maker's parameters are the keys of a recipe of this kind."""
