"""Cut voxels, smeared shares and sums over regions, against polygons, quadrature and plain numpy."""

import numpy as np
import pytest

from accelsurf.kernels import region
from accelsurf.kernels.grid import BLOCK, Band, Lattice
from tests import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
DIRECTIONS = [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 1, 0), (0, 1, -2), (1, 1, 1), (-0.3, 0.8, 0.52), (0.05, 1, 0.02)]


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), SPACING])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_cut_voxel_is_the_exact_polygon(direction, spacing):
    grid = reference.grid_of((3, 3, 3), spacing)
    n = np.array(direction) / np.linalg.norm(direction)
    reach = 0.5 * np.abs(n) @ spacing
    for psi in np.linspace(-1.2, 1.2, 23) * reach:
        want = reference.cut_voxel(psi, n, spacing)[0]
        assert region.cut_voxel(psi, *(2.5 * n), grid) == pytest.approx(want, abs=3e-4)


def test_cut_voxel_by_counting_points():
    """A twin of the twin: share of a fine lattice of points."""
    grid = reference.grid_of((3, 3, 3), SPACING)
    u = (np.arange(60) + 0.5) / 60 - 0.5
    z, y, x = np.meshgrid(*(u * h for h in SPACING), indexing="ij")
    for n in [(0.2, -0.5, 0.84), (0.9, 0.3, 0.3)]:
        n = np.array(n) / np.linalg.norm(n)
        for psi in (-0.6, -0.1, 0.0, 0.4):
            want = np.mean(psi + n[0] * z + n[1] * y + n[2] * x < 0)
            assert region.cut_voxel(psi, *n, grid) == pytest.approx(want, abs=0.01)


def test_cut_voxel_without_a_gradient_is_in_or_out():
    grid = reference.grid_of((3, 3, 3), SPACING)
    assert region.cut_voxel(-0.1, 0.0, 0.0, 0.0, grid) == 1.0
    assert region.cut_voxel(0.1, 0.0, 0.0, 0.0, grid) == 0.0


@pytest.mark.parametrize("axis", range(3))
def test_a_face_exactly_between_two_voxels_is_shared_by_them(axis):
    grid, n = reference.grid_of((3, 3, 3), SPACING), np.eye(3)[axis]
    inner, outer = (region.cut_voxel(sign * 0.5 * SPACING[axis], *n, grid) for sign in (-1, 1))
    assert inner + outer == pytest.approx(1, abs=1e-6)
    assert inner > 0.9999


@pytest.mark.parametrize(("d", "voxels"), [(0.0, 0.0), (0.3, 0.4), (-0.9, 1.2), (1.2, 1.6)])
def test_smeared_area_by_its_formula(d, voxels):
    """On a sphere: the delta function, less the part d^2 K by which the levels have more area."""
    spacing, r = (1.0, 1.0, 0.75), 9.0
    grid = reference.grid_of((5, 5, 5), spacing)
    z, y, x = reference.coordinates((5, 5, 5), spacing, (2.0, 2.0, 1.5))
    psi = (np.sqrt(z**2 + y**2 + (x + r + d) ** 2) - r).astype(np.float32).ravel()
    got = region.smeared_area(psi, d, voxels, 62, 2, 2, 2, grid)
    mm = 0.75  # the normal lies along x
    delta = (1 + np.cos(np.pi * voxels / 1.5)) / (3 * mm) if voxels < 1.5 else 0.0
    assert got == pytest.approx(delta * (1 - d**2 / (r + d) ** 2) * np.prod(spacing), rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("direction", [(0.3, -0.7, 0.65), (1 / 3.0, 1, 1 / 0.7)])
@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 6)])
def test_cut_band_of_a_plane_is_exact_up_to_the_border(shape, direction):
    """Shares add up to the volume on one side, areas to the polygon that the plane cuts out of the box."""
    n = np.array(direction)
    if shape[0] == 1:
        n[0] = 0  # kernels see no slope across a single slice
    n /= np.linalg.norm(n)
    centre = (np.array(shape) - 1) / 2 * SPACING
    z, y, x = reference.coordinates(shape, SPACING, centre)
    psi = (n[0] * z + n[1] * y + n[2] * x - 0.15).astype(np.float32)
    dense, band = reference.whole_band(psi, -psi.reshape(-1, 1) * n)
    part, area = np.empty(psi.size), np.empty(psi.size)
    region.cut_band(0, psi.size, dense.psi, reference.grid_of(shape, SPACING), band, part, area)
    box = np.array(shape) * SPACING
    want_part, want_area = reference.cut_voxel(-0.15, n, box)
    assert part.sum() * np.prod(SPACING) == pytest.approx(want_part * box.prod(), rel=1e-4)
    # The layer that the area is measured in is cut off at the border, on one side more than on the other.
    assert area.sum() == pytest.approx(want_area, rel=0.05)
    each = [reference.cut_voxel(float(d), n, SPACING)[0] for d in psi.ravel()]
    np.testing.assert_allclose(part, each, atol=4e-4)


def test_cut_band_reaches_the_corners_of_the_voxels():
    """A plane across the diagonal cuts off the last corner of voxels half a diagonal away."""
    shape, n = (6, 7, 8), np.full(3, 1 / np.sqrt(3))
    z, y, x = reference.coordinates(shape, (1, 1, 1), (2.5, 3.0, 3.5))
    psi = ((z + y + x - 0.4) / np.sqrt(3)).astype(np.float32)
    dense, band = reference.whole_band(psi)
    part, area = np.empty(psi.size), np.empty(psi.size)
    region.cut_band(0, psi.size, dense.psi, reference.grid_of(shape, (1, 1, 1)), band, part, area)
    want = np.array([reference.cut_voxel(float(d), n, (1, 1, 1))[0] for d in psi.ravel()])
    far = np.abs(psi.ravel()) > 0.75
    assert (want[far] * (1 - want[far])).max() > 1e-4
    np.testing.assert_allclose(part, want, atol=1e-4)


@pytest.mark.parametrize("epsilon", [1.0, 1.5, 2.5])
def test_smeared_share_is_the_integral_of_the_delta_function(epsilon):
    rng = np.random.default_rng(1)
    foot = rng.uniform(-1, 1, (60, 3)) * SPACING * 2
    sign = np.where(rng.random(60) < 0.5, -1.0, 1.0)
    psi = sign * np.linalg.norm(foot, axis=1)
    band = Band(np.arange(60), psi.astype(np.float32), foot.astype(np.float32))
    part = np.empty(60)
    region.smear_band(0, 60, reference.grid_of((60, 1, 1), SPACING), band, epsilon, part)
    s = sign * np.linalg.norm(foot / SPACING, axis=1)
    np.testing.assert_allclose(part, [reference.smeared_share(v, epsilon) for v in s], atol=1e-6)


def test_weighted_sums_by_blocks():
    rng = np.random.default_rng(2)
    n = 2 * BLOCK + 37
    image = rng.standard_normal(3 * n).astype(np.float32)
    cells = np.sort(rng.choice(image.size, n, replace=False))
    weight = np.where(rng.random(n) < 0.2, 0.0, rng.random(n))
    sums = np.full((4, 3), -1.0)
    region.weighted_sums(0, 3, cells, weight, image, sums)
    values = image[cells].astype(np.float64)
    for block in range(3):
        part = slice(block * BLOCK, (block + 1) * BLOCK)
        want = [(weight[part] * values[part] ** p).sum() for p in range(3)]
        np.testing.assert_allclose(sums[block], want, rtol=1e-12)
    assert (sums[3] == -1).all()


def test_inside_sums_leave_the_band_and_the_outside_out():
    rng = np.random.default_rng(3)
    n = 2 * BLOCK + 11
    psi = rng.standard_normal(n).astype(np.float32)
    slot = np.where(rng.random(n) < 0.3, 5, -1).astype(np.int32)
    image = rng.standard_normal(n).astype(np.float32)
    sums = np.zeros((3, 3))
    region.inside_sums(0, 3, Lattice(psi, slot), image, sums)
    counted = image[(psi < 0) & (slot < 0)].astype(np.float64)
    np.testing.assert_allclose(sums.sum(axis=0), [counted.size, counted.sum(), (counted**2).sum()], rtol=1e-12)
