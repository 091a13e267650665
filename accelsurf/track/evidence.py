"""Evidence that a frame shows an object: the image across its surface, its volume and its area, beside earlier ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import overlap, shared
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.track.records import SurfacePiece

#: An object is seen where volume and area are within this factor of the expected ones, and the image across the
#: surface has at least one over this factor of the structure that it had.
FACTOR = 2.0
#: Values across the surface are means over layers of a voxel: this number on either side.
LAYERS = 3
#: Places nearer to another object than this, voxels, say nothing of this one.
APART = 2.0


class Profile(NamedTuple):
    """Means of the image over layers along the surface, from deep inside to far outside; nan where there is none."""

    values: tuple[float, ...]

    def strength(self, before: Profile) -> float:
        """Part of the structure ``before`` that is there: 1 for all of it, 0 for none, below 0 for its reverse.

        The coefficient of the regression of these values on those before. Where there was no structure it is 1.

        Examples
        --------
        >>> step = Profile((9.0, 9.0, 5.0, 1.0, 1.0, 1.0))
        >>> Profile((5.0, 5.0, 3.0, 1.0, 1.0, 1.0)).strength(step)
        0.5
        """
        now, then = np.array(self.values), np.array(before.values)
        known = np.isfinite(now) & np.isfinite(then)
        if known.sum() < 2:
            return 1.0
        now, then = now[known] - now[known].mean(), then[known] - then[known].mean()
        power = float(then @ then)
        return float(now @ then) / power if power > 0 else 1.0

    @property
    def inner(self) -> float:
        """Value of the object: the mean of the layers inside, without that at the surface."""
        return _mean(self.values[: LAYERS - 1])

    @property
    def outer(self) -> float:
        """Value around the object: the mean of the layers outside, without that at the surface."""
        return _mean(self.values[LAYERS + 1 :])


def median_profile(profiles: Sequence[Profile]) -> Profile:
    """The median of each layer over several profiles.

    Examples
    --------
    >>> median_profile([Profile((1.0, float("nan"))), Profile((3.0, float("nan"))), Profile((9.0, 2.0))])
    Profile(values=(3.0, 2.0))
    """
    layers = zip(*(profile.values for profile in profiles), strict=True)
    known = ([value for value in layer if np.isfinite(value)] for layer in layers)
    return Profile(tuple(float(np.median(layer)) if layer else float("nan") for layer in known))


def profile(image: Volume, surface: SurfacePiece, others: Sequence[SurfacePiece] = ()) -> Profile:
    """Values of a frame across a surface.

    Parameters
    ----------
    image : Volume
    surface : SurfacePiece
        A signed distance in the layers.
    others : sequence of SurfacePiece
        Objects beside it.
    """
    geometry, psi = image.geometry, surface.psi
    step = min(geometry.steps)
    layer = np.floor(psi / np.float32(step)).astype(np.int64) + LAYERS
    layer[(layer < 0) | (layer >= 2 * LAYERS)] = 2 * LAYERS
    for other in others:
        _leave_out(layer, surface, other, APART * step)
    values = image.array[surface.box].astype(np.float64)
    count = np.bincount(layer.ravel(), minlength=2 * LAYERS + 1)[:-1]
    total = np.bincount(layer.ravel(), values.ravel(), 2 * LAYERS + 1)[:-1]
    means = np.divide(total, count, out=np.full(2 * LAYERS, np.nan), where=count > 0)
    return Profile(tuple(means.tolist()))


def _leave_out(
    layer: NDArray[np.int64], surface: SurfacePiece, other: SurfacePiece, near: float
) -> None:
    """Put voxels near another object into no layer, in place."""
    if overlap(surface.box, other.box):
        mine, theirs = shared(surface.corner, surface.psi.shape, other.corner, other.psi.shape)
        layer[mine][other.psi[theirs] < near] = 2 * LAYERS


def is_shown(
    now: Profile,
    before: Profile,
    volumes: tuple[float, float],
    areas: tuple[float, float],
    matched: bool = False,
) -> bool:
    """Decide if a frame shows an object.

    Parameters
    ----------
    now, before : Profile
        Across the surface that was found, and across that of the frame in which the object was seen last.
    volumes, areas : (found, expected)
        mm3 and mm2.
    matched : bool
        Whether the image around the surface was found again in the frame: that is evidence too, and half of the
        structure is enough.
    """
    if not all(
        found * FACTOR >= expected and found <= expected * FACTOR
        for found, expected in (volumes, areas)
    ):
        return False
    return now.strength(before) * FACTOR * (FACTOR if matched else 1.0) >= 1.0


def volume_in_grid(psi: NDArray[np.float32], geometry: Geometry) -> float:
    """Volume inside, mm3, as far as the grid goes: to parts of a voxel, by the distance of its centre."""
    share = np.clip(0.5 - psi / np.float32(min(geometry.steps)), 0.0, 1.0)
    return float(share.sum(dtype=np.float64)) * geometry.voxel_volume


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")
