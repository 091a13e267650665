"""Local regions, likelihoods and thresholds: forces are derivatives of values; moving sums against slow twins."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from accelsurf.energies import (
    Area,
    Balloon,
    ChanVese,
    Gaussian,
    GaussianLikelihood,
    HistogramLikelihood,
    LocalRegion,
    Threshold,
    WeightedSum,
)
from accelsurf.levelset import LevelSet

GRIDS = {
    "3D": ((40, 44, 42), (1.0, 0.9, 1.1)),
    "thick slices": ((26, 44, 48), (2.0, 1.0, 0.9)),
    "one slice": ((1, 96, 100), (3.0, 0.5, 0.45)),
}


def coordinates(grid):
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(*GRIDS[grid], strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def smooth_field(grid, seed, width=5.0):
    shape, spacing = GRIDS[grid]
    field = gaussian_filter(np.random.default_rng(seed).normal(size=shape), [width / h for h in spacing], mode="wrap")
    return field / np.abs(field).max()


def image(grid):
    """A soft ball with a drift of brightness across it, between about -1 and 2."""
    z, y, x = coordinates(grid)
    return np.tanh((9.0 - np.sqrt(1.2 * z**2 + y**2 + 0.8 * x**2)) / 3) + 0.3 * smooth_field(grid, 1) + 0.02 * x


SAMPLES = tuple(np.random.default_rng(seed).normal(mean, 0.5, 4000) for seed, mean in ((1, 0.7), (2, -0.8)))
PHI = 0.4
ENERGIES = {
    "local": lambda grid: LocalRegion(image(grid), 6.0),
    "local, smeared, area": lambda grid: LocalRegion(image(grid), 4.0, alpha=0.5, epsilon=1.5),
    "gauss": lambda grid: GaussianLikelihood(image(grid)),
    "gauss, smeared, area": lambda grid: GaussianLikelihood(image(grid), alpha=0.7, epsilon=1.5),
    "gauss, fixed": lambda grid: GaussianLikelihood(
        image(grid), models=(Gaussian(0.7, 0.2), Gaussian(-0.8, 0.4))
    ),
    "histogram": lambda grid: HistogramLikelihood(image(grid)),
    "histogram, smeared, area": lambda grid: HistogramLikelihood(image(grid), alpha=0.7, epsilon=1.5),
    "histogram, fixed": lambda grid: HistogramLikelihood(image(grid), samples=SAMPLES),
    "threshold": lambda grid: Threshold(image(grid), low=0.2),
    "threshold, window, area": lambda grid: Threshold(image(grid), -0.2, 0.9, soft=0.4, alpha=0.8),
    "sum": lambda grid: WeightedSum(
        [
            (2.0, ChanVese(image(grid))),
            (0.5, Threshold(image(grid), low=0.1)),
            (-0.2, Balloon()),
            (0.3, Area()),
        ]
    ),
}


def value(energy, psi, grid):
    surface = LevelSet(psi, GRIDS[grid][1], 4.0)
    energy.start(surface)
    part, area = surface.cut()
    return energy.value(surface, part, area), surface, area


def works(energy, grid, seed, step=0.3):
    """Of a smooth outward perturbation eta: dU measured by differences, and f eta dA (n,)."""
    z, y, x = coordinates(grid)
    psi = np.sqrt(z**2 + y**2 + x**2) - 13.0 - smooth_field(grid, 7)
    eta = 0.6 + smooth_field(grid, seed)
    distance = value(energy, psi, grid)[1].psi.copy()
    up, down = (value(energy, distance - sign * step * eta, grid)[0] for sign in (1, -1))
    _, surface, area = value(energy, distance, grid)
    front = surface.front()
    force = energy.force(surface, front, surface.curvature(front))
    return (up - down) / (2 * step), force * eta.ravel()[surface.band.cells] * area


class Wrong(WeightedSum):
    """Any energy with the sign of its force turned."""

    def force(self, surface, front, curvature):
        return -super().force(surface, front, curvature)


class PointwiseMeans(LocalRegion):
    """The usual short cut: f = (I - f1)^2 - (I - f2)^2 with the means at the point only."""

    def _smooth(self, surface, field):
        if getattr(self, "_at_means", False):
            return field
        return super()._smooth(surface, field)

    def value(self, surface, part, area):
        got = super().value(surface, part, area)
        return got


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("name", ENERGIES)
def test_the_force_is_the_derivative_of_the_discrete_energy(name, grid, seed):
    measured, work = works(ENERGIES[name](grid), grid, seed)
    print(f"\n{name} {grid}: off by {(measured - work.sum()) / np.abs(work).sum():+.3%}")
    assert abs(measured - work.sum()) <= 0.02 * np.abs(work).sum()
    # Far from cancelling, so that a wrong sign or factor could not pass.
    assert abs(work.sum()) > 0.2 * np.abs(work).sum()


@pytest.mark.parametrize("name", ENERGIES)
def test_the_wrong_sign_is_no_derivative(name):
    measured, work = works(Wrong([(1.0, ENERGIES[name]("3D"))]), "3D", 2)
    assert abs(measured - work.sum()) > 0.4 * np.abs(work).sum()
