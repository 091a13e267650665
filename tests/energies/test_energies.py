import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from accelsurf.energies import ChanVese, RegionField
from accelsurf.levelset import LevelSet
from tests.support.energies import evolve, value

SHAPE, SPACING, RADIUS = (40, 44, 42), (1.0, 0.9, 1.1), 13.0


def coordinates():
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(SHAPE, SPACING, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def smooth_field(seed):
    """A random field, smooth over a few voxels, of size about 1."""
    field = gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 5)
    return field / np.abs(field).max()


def image():
    z, y, x = coordinates()
    return np.tanh((8.0 - np.sqrt(1.2 * z**2 + y**2 + 0.8 * x**2)) / 3) + 0.3 * smooth_field(1)


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


@pytest.mark.parametrize("name", ENERGIES)
@pytest.mark.parametrize("seed", [2, 3])
def test_the_force_is_the_derivative_of_the_discrete_energy(name, seed):
    """dU/d(epsilon) under a smooth normal perturbation eta (outward) is -int f (eta n.N) dA = +int f eta dA."""
    z, y, x = coordinates()
    psi = np.sqrt(z**2 + y**2 + x**2) - RADIUS - smooth_field(7)
    # A one-signed part, so that the derivative is not a small difference of large numbers.
    eta = 0.6 + smooth_field(seed)
    energy = ENERGIES[name]()
    distance = value(energy, psi, SPACING)[1].psi.copy()
    step = 0.05
    up, down = (value(energy, distance - sign * step * eta, SPACING)[0] for sign in (1, -1))
    measured = (up - down) / (2 * step)

    _, surface, area = value(energy, distance, SPACING)
    front = surface.front()
    force = energy.force(surface, front, surface.curvature(front))
    cells = surface.band.cells
    work = force * eta.ravel()[cells] * area
    assert np.sign(measured) == np.sign(work.sum())
    assert abs(measured - work.sum()) <= 0.02 * np.abs(work).sum()
    # Far from cancelling, so that a wrong sign or factor could not pass.
    assert abs(work.sum()) > 0.2 * np.abs(work).sum()


def test_region_sums_kept_up_to_date_equal_full_ones():
    energy = ChanVese(image(), epsilon=1.5)
    z, y, x = coordinates()
    surface = LevelSet(np.sqrt(z**2 + y**2 + (x - 4) ** 2) - 7, SPACING)
    updated = evolve(energy, surface, 25)
    assert (surface.psi < 0).sum() > 1.5 * 4 / 3 * np.pi * 7**3 / np.prod(SPACING)  # it did move
    energy.start(surface)
    assert updated == pytest.approx(energy.value(surface, *surface.fraction_and_area()), rel=1e-12)


def test_value_of_a_known_region():
    """A ball in a field of 1: U is its volume; with an area weight, its area besides; within 1 %."""
    z, y, x = coordinates()
    surface_psi = np.sqrt(z**2 + y**2 + x**2) - RADIUS
    field = np.ones(SHAPE)
    assert value(RegionField(field), surface_psi, SPACING)[0] == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)
    both = value(RegionField(field, alpha=2.0), surface_psi, SPACING)[0]
    assert both == pytest.approx(4 / 3 * np.pi * RADIUS**3 + 8 * np.pi * RADIUS**2, rel=0.01)


def test_chan_vese_of_two_constants_is_zero_and_its_means_are_theirs():
    z, y, x = coordinates()
    psi = np.abs(z) - 0.25 * SHAPE[0]  # planes halfway between voxel centres: no voxel is cut
    two = np.where(psi < 0, 5.0, 2.0)
    energy = ChanVese(two)
    assert value(energy, psi, SPACING)[0] < 1e-4 * two.size  # of 2.25 per voxel with one mean
    assert energy.means == pytest.approx((5.0, 2.0), abs=1e-4)


def test_a_force_above_0_shrinks():
    """Outside the object (dark) f > 0 for a start that is too large, inside f < 0 for one that is too small."""
    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    energy = ChanVese((r < 10) * 1.0)
    for radius, sign in ((13.0, 1), (7.0, -1)):
        surface = value(energy, r - radius, SPACING)[1]
        front = surface.front()
        force = energy.force(surface, front, surface.curvature(front))[front]
        assert (np.sign(force) == sign).all()


def test_balance_moves_the_boundary_to_brighter_values():
    """l1 (I - c1)^2 = l2 (I - c2)^2 at I = (sqrt(l1) c1 + sqrt(l2) c2)/(sqrt(l1) + sqrt(l2))."""
    z, y, x = coordinates()
    ramp = np.clip(0.5 - x / 20, 0, 1)
    root = np.sqrt(4.0)
    level = root / (root + 1)
    energy = ChanVese(ramp, means=(1.0, 0.0), balance=4.0)
    surface = value(energy, x - (0.5 - level) * 20, SPACING)[1]
    front = surface.front()
    assert np.abs(energy.force(surface, front, surface.curvature(front))).max() < 1e-5
