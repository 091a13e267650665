import numpy as np
import pytest

from accelsurf.energies import ChanVese, RegionField
from accelsurf.levelset import LevelSet
from tests.support.gradient_check import (
    GRIDS,
    RADIUS,
    assert_derivative,
    coordinates,
    smooth_field,
    value,
    value_after_steps,
)

GRID = "3D"
SHAPE, SPACING = GRIDS[GRID]


def image():
    z, y, x = coordinates(GRID)
    return np.tanh((8.0 - np.sqrt(1.2 * z**2 + y**2 + 0.8 * x**2)) / 3) + 0.3 * smooth_field(
        GRID, 1
    )


ENERGIES = {
    "chan-vese": lambda: ChanVese(image()),
    "chan-vese, area": lambda: ChanVese(image(), alpha=1.5),
    "chan-vese, smeared": lambda: ChanVese(image(), epsilon=1.5),
    "chan-vese, smeared, area": lambda: ChanVese(image(), alpha=1.5, epsilon=1.5),
    "chan-vese, balance, smeared": lambda: ChanVese(image(), epsilon=1.5, balance=2.5),
    "chan-vese, balance, fixed means": lambda: ChanVese(image(), balance=0.4, means=(0.8, -0.7)),
    "field": lambda: RegionField(image() + 0.5),
    "field, area": lambda: RegionField(image() + 1.5, alpha=1.5),
}


@pytest.mark.sampled
@pytest.mark.parametrize("name", ENERGIES)
@pytest.mark.parametrize("seed", [2, 3])
def test_the_force_is_the_derivative_of_the_discrete_energy(name, seed):
    """dU/d(epsilon) under a smooth normal perturbation eta (outward) is -int f (eta n.N) dA = +int f eta dA."""
    assert_derivative(ENERGIES[name](), GRID, seed, step=0.05)


def test_updated_region_sums_equal_full_ones():
    energy = ChanVese(image(), epsilon=1.5)
    z, y, x = coordinates(GRID)
    surface = LevelSet(np.sqrt(z**2 + y**2 + (x - 4) ** 2) - 7, SPACING)
    updated, afresh = value_after_steps(energy, surface)
    assert (surface.psi < 0).sum() > 1.5 * 4 / 3 * np.pi * 7**3 / np.prod(SPACING)  # it did move
    assert updated == pytest.approx(afresh, rel=1e-12)


def test_value_of_a_known_region():
    """A ball in a field of 1: U is its volume; with an area weight, its area besides; within 1 %."""
    z, y, x = coordinates(GRID)
    surface_psi = np.sqrt(z**2 + y**2 + x**2) - RADIUS
    field = np.ones(SHAPE)
    assert value(RegionField(field), surface_psi, GRID)[0] == pytest.approx(
        4 / 3 * np.pi * RADIUS**3, rel=0.01
    )
    both = value(RegionField(field, alpha=2.0), surface_psi, GRID)[0]
    assert both == pytest.approx(4 / 3 * np.pi * RADIUS**3 + 8 * np.pi * RADIUS**2, rel=0.01)


def test_chan_vese_of_two_constants_is_zero_and_its_means_are_theirs():
    z, y, x = coordinates(GRID)
    psi = np.abs(z) - 0.25 * SHAPE[0]  # planes halfway between voxel centres: no voxel is cut
    two = np.where(psi < 0, 5.0, 2.0)
    energy = ChanVese(two)
    assert value(energy, psi, GRID)[0] < 1e-4 * two.size  # of 2.25 per voxel with one mean
    assert energy.means == pytest.approx((5.0, 2.0), abs=1e-4)


def test_a_force_above_0_shrinks():
    """Outside the object (dark) f > 0 for a start that is too large, inside f < 0 for one that is too small."""
    z, y, x = coordinates(GRID)
    r = np.sqrt(z**2 + y**2 + x**2)
    energy = ChanVese((r < 10) * 1.0)
    for radius, sign in ((13.0, 1), (7.0, -1)):
        surface = value(energy, r - radius, GRID)[1]
        front = surface.front()
        force = energy.force(surface, front, surface.curvature(front))[front]
        assert (np.sign(force) == sign).all()


def test_balance_moves_the_boundary_to_brighter_values():
    """l1 (I - c1)^2 = l2 (I - c2)^2 at I = (sqrt(l1) c1 + sqrt(l2) c2)/(sqrt(l1) + sqrt(l2))."""
    z, y, x = coordinates(GRID)
    ramp = np.clip(0.5 - x / 20, 0, 1)
    root = np.sqrt(4.0)
    level = root / (root + 1)
    energy = ChanVese(ramp, means=(1.0, 0.0), balance=4.0)
    surface = value(energy, x - (0.5 - level) * 20, GRID)[1]
    front = surface.front()
    assert np.abs(energy.force(surface, front, surface.curvature(front))).max() < 1e-5
