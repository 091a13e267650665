"""Chan-Vese: the image is one constant inside and another outside; localised, within a window around each voxel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import check_shape
from accelsurf.energies.image_energy import AreaTerm, RegionEnergy
from accelsurf.energies.region_sums import Elsewhere, Interface, RegionMoments
from accelsurf.grid.boxes import runs
from accelsurf.kernels import windows
from accelsurf.levelset import BandChange, LevelSet

#: Half width of the tent along each axis that has the variance of a ball of radius 1.
TENT = math.sqrt(6.0 / 5.0)
#: Nodes per half width of the tent, where they are not closer than two voxels.
_MAX_HALF_WIDTH = 4
_MIN_HALF_WIDTH = 2
#: A window with no more than this part on one side of the surface does not count.
MIN_SHARE = 1e-6


class TwoMeans(NamedTuple):
    """Means of the image inside and outside."""

    inside: float
    outside: float


class ChanVese(RegionEnergy):
    """U = l1 int_in (I - c1)^2 + l2 int_out (I - c2)^2 + alpha A, f = l1 (I - c1)^2 - l2 (I - c2)^2 + alpha H.

    The first variation of the paper's region energy for an inward normal. c1 and c2 are the means inside and
    outside, at each step of the present surface (by the envelope theorem they add nothing to f).

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in that unit squared times mm3.
    alpha : float
        Weight of the area, in the image's unit squared times mm.
    means : TwoMeans, optional
        Fixed (c1, c2) instead of the surface's own.
    epsilon : float
        Half width of the smeared interface in voxels; 0 is sharp. See `Interface`.
    balance : float
        l1/l2, with l1 + l2 = 2: above 1 the inside must fit its mean more closely than the outside its own.
    elsewhere : Elsewhere, optional
        `RegionMoments` of the part of the object and of the image that are not on this grid; they count in the means.
    whole : RegionMoments, optional
        Of the whole image, where this grid is a window of it; by default of ``image``.
    """

    def __init__(
        self,
        image: np.ndarray,
        alpha: float = 0.0,
        means: TwoMeans | None = None,
        epsilon: float = 0.0,
        balance: float = 1.0,
        elsewhere: Elsewhere | None = None,
        whole: RegionMoments | None = None,
    ) -> None:
        super().__init__(image, alpha, epsilon, elsewhere, whole)
        self._weights = (2.0 * balance / (1.0 + balance), 2.0 / (1.0 + balance))
        self._fixed = means
        self.means = means or TwoMeans(0.0, 0.0)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also sets `means` for the next `force`."""
        energy = 0.0
        means = []
        for i, sums in enumerate(self.regions(surface, fraction)):
            mean = (
                self._fixed[i]
                if self._fixed
                else sums.total / sums.voxels
                if sums.voxels > 0
                else 0.0
            )
            means.append(mean)
            energy += self._weights[i] * (
                sums.squares - 2.0 * mean * sums.total + mean * mean * sums.voxels
            )
        self.means = TwoMeans(*means)
        return energy * surface.voxel_volume + self._area.value(area)

    def polynomial(self) -> tuple[float, float, float]:
        """Factors of the force, between the means of the last `value`."""
        (c1, c2), (l1, l2) = self.means, self._weights
        return l1 - l2, 2.0 * (l2 * c2 - l1 * c1), l1 * c1 * c1 - l2 * c2 * c2


class LocalRegion(Energy):
    """U = int dx int K(x - y) (I(y) - f(x))^2 dy + alpha A, f the mean f1 or f2 of its window and side at x.

    f = int K(x - y) [(I(y) - f1(x))^2 - (I(y) - f2(x))^2] dx + alpha H at a point y of the surface: the exact first
    variation. After Lankton and Tannenbaum (2008), in the form of Li and others (2008), whose windows are centred on
    all voxels near the surface instead of on the surface only: the former has no energy that decreases.

    The window K is a product of tents, (1 - |d|/b) along each axis, b = 1.095 R: two moving sums, with the variance of
    the ball of radius R. Its sums are on nodes b/4 apart (or two voxels, if that is more), see `kernels.windows`: the
    cost of a step is that of the band and of a small lattice, whatever R is. The nodes are symmetric about the
    volume's middle, so that a scan stored with its axes flipped has the same windows.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values in any unit; U is in that unit squared times mm3. Not modified.
    radius : float
        R, mm.
    alpha : float
        Weight of the area, in the image's unit squared times mm.
    epsilon : float
        Half width of the smeared interface in voxels; 0 is sharp. See `Interface`.
    """

    def __init__(
        self, image: np.ndarray, radius: float, alpha: float = 0.0, epsilon: float = 0.0
    ) -> None:
        self._shape = np.shape(image)
        self._image = np.ascontiguousarray(image, dtype=np.float32).ravel()
        self.radius, self.alpha = float(radius), float(alpha)
        self._area = AreaTerm(alpha)
        self._interface = Interface(float(epsilon))
        self._has_nodes = False

    def start(self, surface: LevelSet) -> None:
        """Place the nodes; sum the whole volume, and the inside voxels that are not in the band.

        Raises
        ------
        InputError
            When the image is not on the surface's grid.
        """
        self._place_nodes(surface)
        self._inside = np.zeros_like(self._total)
        where = surface.dense, self._image, surface.grid, self._nodes
        surface.workers.serial(windows.scatter_inside, *where, self._inside[0], self._inside[1])

    def state(self) -> np.ndarray:
        """Return the sums of the inside beyond the band, on the nodes."""
        return self._inside.copy()

    def restore(self, surface: LevelSet, state: np.ndarray) -> None:
        """Set the state that `state` returned on this surface."""
        self._place_nodes(surface)
        self._inside = state.copy()

    def _place_nodes(self, surface: LevelSet) -> None:
        """Place the nodes and sum the whole volume, once."""
        if self._has_nodes:
            return
        check_shape(self._shape, surface)
        grid = surface.grid
        axes = [node_layout(n, self.radius / h) for n, h in zip(grid[:3], grid[3:], strict=True)]
        sizes, distances, before, half_widths = zip(*axes, strict=True)
        self._nodes, self._half_widths = windows.Nodes(*sizes, *distances, *before), half_widths
        count = math.prod(sizes)
        self._total = np.zeros((2, count))
        for some in runs(self._image.size):
            cells = np.arange(some.start, some.stop)
            self._scatter(surface, cells, np.ones(cells.size), self._total)
        self._windows = np.stack(
            [self._smooth(surface, field.reshape(sizes)) for field in self._total]
        )
        n, total = self._windows
        squares = float((self._image.astype(np.float64) ** 2).sum())
        # About one mean in each window.
        self._one_mean = squares - float((total[n > 0] ** 2 / n[n > 0]).sum())
        self._has_nodes = True

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the sums by the cells that entered or left the band."""
        for cells, sign in ((change.left_inside, 1.0), (change.entered_inside, -1.0)):
            self._scatter(surface, cells, np.full(cells.size, sign), self._inside)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; also finds the means for the next `force`."""
        inside = self._inside.copy()
        self._scatter(
            surface, surface.band.cells, self._interface.fraction(surface, fraction), inside
        )
        # Windows that the surface can cross, and the nodes that they are made of.
        crossed, made_of = self._box(surface, 1), self._box(surface, 2)
        within = tuple(
            slice(c.start - m.start, c.stop - m.start)
            for c, m in zip(crossed, made_of, strict=True)
        )
        nodes = (np.ascontiguousarray(field.reshape(self._nodes[:3])[made_of]) for field in inside)
        n1, total1 = (np.ascontiguousarray(self._smooth(surface, field)[within]) for field in nodes)
        n, total = (np.ascontiguousarray(field[crossed]) for field in self._windows)
        means = np.empty((3, n.size))
        surface.workers.parallel(
            windows.two_means,
            n.size,
            n.ravel(),
            total.ravel(),
            n1.ravel(),
            total1.ravel(),
            MIN_SHARE,
            means,
        )
        self._means = [self._smooth(surface, field.reshape(n.shape)).ravel() for field in means[:2]]
        before = [b - s.start for b, s in zip(self._nodes[6:], crossed, strict=True)]
        sizes = dict(zip(("nz", "ny", "nx"), n.shape, strict=True))
        self._near_nodes = self._nodes._replace(**sizes, pz=before[0], py=before[1], px=before[2])
        return (self._one_mean - float(means[2].sum())) * surface.voxel_volume + self._area.value(
            area
        )

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front with the image at each cell's closest surface point, or across it."""
        means = np.empty((surface.size, 2))
        surface.workers.parallel(
            windows.read_nodes,
            surface.size,
            surface.grid,
            surface.band,
            front,
            self._near_nodes,
            tuple(self._means),
            means,
        )
        image = self._interface.force(self._image, surface, front, curvature, (0.0, 1.0, 0.0))
        force: np.ndarray = (means[:, 1] - 2.0 * image * means[:, 0]).astype(np.float32)
        self._area.add_force(force, curvature)
        return force

    def _scatter(
        self, surface: LevelSet, cells: np.ndarray, weight: np.ndarray, sums: np.ndarray
    ) -> None:
        surface.workers.serial(
            windows.scatter, cells, weight, self._image, surface.grid, self._nodes, sums[0], sums[1]
        )

    def _smooth(self, surface: LevelSet, field: np.ndarray) -> np.ndarray:
        """Nodes smoothed by the window, along each axis in turn."""
        step = 1
        for axis in (2, 1, 0):
            size = field.shape[axis]
            if self._half_widths[axis] > 1:
                out = np.empty_like(field)
                half_width = self._half_widths[axis]
                surface.workers.parallel(
                    windows.tent_along,
                    field.size,
                    field.ravel(),
                    size * step,
                    step,
                    half_width,
                    out.ravel(),
                )
                field = out
            step *= size
        return field

    def _box(self, surface: LevelSet, widths: int) -> tuple[slice, ...]:
        """Nodes within ``widths`` half widths of the window around the band."""
        index = (
            np.unravel_index(surface.band.cells, surface.shape) if surface.size else ([0], [0], [0])
        )
        box = []
        for axis in range(3):
            n = self._nodes[axis]
            b = self._nodes[3 + axis]
            before = self._nodes[6 + axis]
            low = math.floor(np.min(index[axis]) / b + before) - widths * self._half_widths[axis]
            high = (
                math.floor(np.max(index[axis]) / b + before) + widths * self._half_widths[axis] + 2
            )
            box.append(slice(max(low, 0), min(high, n)))
        return tuple(box)


def node_layout(n: int, radius: float) -> tuple[int, float, float, int]:
    """Nodes along an axis of ``n`` voxels for a radius in voxels.

    Returns (number, distance in voxels, how many before voxel 0, half width of the tent in nodes).

    They are symmetric about the axis' middle and extend beyond both ends, so that the windows on every voxel add up
    to 1. ``before`` has a part of a distance for the voxels between voxel 0 and the node before it.

    Examples
    --------
    >>> node_layout(10, 5.0)
    (7, 2.73861278752583, 1.3568323274845013, 2)
    """
    if n == 1:
        return 1, 1.0, 0.0, 1
    half = TENT * radius
    half_width = 1 if half < 2.0 else min(_MAX_HALF_WIDTH, max(_MIN_HALF_WIDTH, int(half / 2.0)))
    distance = max(half / half_width, 1.0)
    number = math.ceil((n - 1) / distance) + 1 + 2 * (half_width - 1)
    return number, distance, 0.5 * (number - 1 - (n - 1) / distance), half_width
