"""Cut voxels, smeared shares and sums over regions, against polygons, quadrature and plain numpy."""

import itertools

import numpy as np
import pytest

from accelsurf.kernels import region
from accelsurf.kernels.grid import BATCH, BLOCK, Band, DenseArrays, Grid
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.0, 0.7)
WIDTH = region.AREA_WIDTH
DIRECTIONS = [
    (1, 0, 0),
    (0, -1, 0),
    (0, 0, 1),
    (1, 1, 0),
    (0, 1, -2),
    (1, 1, 1),
    (-0.3, 0.8, 0.52),
    (0.05, 1, 0.02),
]


@pytest.mark.sampled
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), SPACING])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_cut_voxel_is_the_exact_polygon(direction, spacing):
    grid = reference.grid_of((3, 3, 3), spacing)
    n = np.array(direction) / np.linalg.norm(direction)
    reach = 0.5 * np.abs(n) @ spacing
    for psi in np.linspace(-1.2, 1.2, 23) * reach:
        want = reference.cut_voxel(psi, n, spacing)[0]
        assert region.fraction_below_plane(psi, *(2.5 * n), grid) == pytest.approx(want, abs=3e-4)


def test_cut_voxel_by_counting_points():
    """A reference of the reference: share of a fine lattice of points."""
    grid = reference.grid_of((3, 3, 3), SPACING)
    u = (np.arange(60) + 0.5) / 60 - 0.5
    z, y, x = np.meshgrid(*(u * h for h in SPACING), indexing="ij")
    for n in [(0.2, -0.5, 0.84), (0.9, 0.3, 0.3)]:
        n = np.array(n) / np.linalg.norm(n)
        for psi in (-0.6, -0.1, 0.0, 0.4):
            want = np.mean(psi + n[0] * z + n[1] * y + n[2] * x < 0)
            assert region.fraction_below_plane(psi, *n, grid) == pytest.approx(want, abs=0.01)


def test_cut_voxel_without_a_gradient_is_in_or_out():
    grid = reference.grid_of((3, 3, 3), SPACING)
    assert region.fraction_below_plane(-0.1, 0.0, 0.0, 0.0, grid) == 1.0
    assert region.fraction_below_plane(0.1, 0.0, 0.0, 0.0, grid) == 0.0


@pytest.mark.parametrize("axis", range(3))
def test_a_face_exactly_between_two_voxels_is_shared_by_them(axis):
    grid, n = reference.grid_of((3, 3, 3), SPACING), np.eye(3)[axis]
    inner, outer = (
        region.fraction_below_plane(sign * 0.5 * SPACING[axis], *n, grid) for sign in (-1, 1)
    )
    assert inner + outer == pytest.approx(1, abs=1e-6)
    assert inner > 0.9999


@pytest.mark.parametrize(("d", "voxels"), [(0.0, 0.0), (0.3, 0.4), (-0.9, 1.2), (1.2, 1.6)])
def test_smeared_area_by_its_formula(d, voxels):
    """On a sphere: the delta function, less the part d^2 K by which the levels have more area."""
    spacing, r = (1.0, 1.0, 0.75), 9.0
    grid = reference.grid_of((5, 5, 5), spacing)
    got = region.smeared_area(d, voxels, 0.0, 0.0, 1.0, (r + d) ** -2, grid, WIDTH)
    mm = 0.75  # the normal lies along x
    delta = (1 + np.cos(np.pi * voxels / 1.5)) / (3 * mm) if voxels < 1.5 else 0.0
    assert got == pytest.approx(
        delta * (1 - d**2 / (r + d) ** 2) * np.prod(spacing), rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize("gauss", [9.0, -9.0])
def test_smeared_area_changes_by_a_quarter_at_most_however_curved(gauss):
    grid = reference.grid_of((5, 5, 5), SPACING)
    flat, curved = (
        region.smeared_area(0.5, 0.6, 0.3, -0.2, 0.9, k, grid, WIDTH) for k in (0.0, gauss)
    )
    assert curved == pytest.approx(flat * (1 - np.sign(gauss) / 4))


def test_smeared_area_beside_the_surface_takes_its_normal_from_the_gradient():
    """Where the closest point is too short to tell one; the length of the gradient does not matter."""
    grid, n = reference.grid_of((5, 5, 5), SPACING), np.array((0.3, -0.7, 0.65))
    n /= np.linalg.norm(n)
    per_mm = np.linalg.norm(n / SPACING)
    want = 2 / 3 * per_mm * np.prod(SPACING)
    for size in (1.0, 0.4, 7.0):
        assert region.smeared_area(0.0, 0.0, *(size * n), 0.0, grid, WIDTH) == pytest.approx(want)
    assert region.smeared_area(0.011 / per_mm, 0.011, *n, 0.0, grid, WIDTH) == pytest.approx(
        want, rel=1e-3
    )


def unwritten(n):
    """Arrays for the four measures of `measure_band`, filled with NaN."""
    return tuple(
        np.full(n, np.nan, kind) for kind in (np.float64, np.float64, np.float32, np.float32)
    )


def all_measured(psi, spacing, closest_point, within):
    """(part, area, bend, variation) by `measure_band` of a whole band."""
    dense, band = reference.whole_band(psi, closest_point)
    out = unwritten(band.cells.size)
    grid = reference.grid_of(np.shape(psi), spacing)
    region.measure_band(0, band.cells.size, dense.psi, grid, band, within, out)
    assert all(np.isfinite(one).all() for one in out)
    return out


def measured(psi, spacing, closest_point, within):
    """(part, area, bend) by `measure_band` of a whole band."""
    return all_measured(psi, spacing, closest_point, within)[:3]


def down_the_gradient(psi, spacing):
    """(closest points (n, 3) at psi off each voxel down its gradient, that gradient)."""
    gradient = reference.derivatives(psi, spacing)[0].reshape(-1, 3)
    norm = np.linalg.norm(gradient, axis=1, keepdims=True)
    return -np.reshape(psi, (-1, 1)) * gradient / np.maximum(norm, 1e-12), gradient


#: Voxels whose neighbours are all there, and volumes of nothing but border; 504 voxels are more than one chunk.
MEASURED = [(7, 9, 8), (1, 9, 12), (3, 4, 5), (2, 5, 6), (5, 1, 6)]


@pytest.mark.sampled
@pytest.mark.parametrize("within", [1.0, 2.0, 9.0])
@pytest.mark.parametrize("shape", MEASURED)
def test_measured_curvature_and_variation_as_the_reference(shape, within):
    """The variation differs by what the level's H does when psi is mirrored at the border."""
    psi = (0.8 * reference.smooth_noise(shape, 2, 2.0)).astype(np.float32)
    closest_point, gradient = down_the_gradient(psi, SPACING)
    _, _, bend, variation = all_measured(psi, SPACING, closest_point, within)
    want = reference.surface_curvature(psi, SPACING).ravel()
    k = reference.principal_curvatures(psi, SPACING).reshape(-1, 2)
    mirrored = reference.principal_curvatures(psi, SPACING, mirrored=True).reshape(-1, 2)
    mirrored_slope = np.linalg.norm(
        reference.derivatives(psi, SPACING, mirrored=True)[0].reshape(-1, 3), axis=1
    )
    voxels = np.linalg.norm(closest_point.astype(np.float32).astype(float) / SPACING, axis=1)
    near, steep = voxels <= within, np.linalg.norm(gradient, axis=1) > 0.1
    assert (near & steep).sum() > 8
    # The reference divides by 1 - d k of each curvature, which is ill conditioned beside the centre of curvature.
    factors = 1 - psi.ravel()[:, None] * k
    tame, most = (
        near & steep & (np.abs(factors.prod(axis=1) - 0.2) > 1e-3),
        np.float32(2 / min(SPACING)),
    )
    np.testing.assert_allclose(bend[tame], want[tame], rtol=2e-3, atol=2e-4)
    on = tame & (mirrored_slope > 0.1)
    moved = np.clip(want + mirrored.sum(axis=1) - k.sum(axis=1), -most, most)
    np.testing.assert_allclose(variation[on], moved[on], rtol=2e-3, atol=2e-3)
    assert not bend[~near].any() and not variation[~near].any()
    assert np.abs(bend).max() <= most and np.abs(variation).max() <= most


@pytest.mark.parametrize("shape", MEASURED)
def test_the_area_s_variation_is_the_curvature_but_at_the_border(shape):
    psi = (0.8 * reference.smooth_noise(shape, 2, 2.0)).astype(np.float32)
    closest_point, _ = down_the_gradient(psi, SPACING)
    _, _, bend, variation = (
        one.reshape(shape) for one in all_measured(psi, SPACING, closest_point, 9.0)
    )
    inside = tuple(slice(1, -1) if n > 1 else slice(None) for n in shape)
    np.testing.assert_array_equal(variation[inside], bend[inside])
    assert (variation != bend).any()


def test_measured_curvature_of_a_ball_is_that_at_the_closest_point():
    """The same 2/r two voxels inside and two outside."""
    shape, spacing, radius = (25, 25, 13), (1.0, 1.0, 2.0), 8.0
    z, y, x = reference.coordinates(
        shape, spacing, (np.array(shape) - 1) / 2 * spacing + (0.1, -0.2, 0.15)
    )
    psi = np.sqrt(z**2 + y**2 + x**2) - radius
    closest_point = -(psi / (psi + radius))[..., None] * np.stack([z, y, x], axis=-1)
    _, _, bend = measured(psi, spacing, closest_point, 2.5)
    front = (np.abs(psi) < 2).ravel()
    assert np.abs(bend[front] * radius / 2 - 1).max() < 0.12
    assert bend[front].mean() == pytest.approx(2 / radius, rel=0.02)
    not_undone = 2 / (radius + psi.ravel()[front])
    assert np.abs(not_undone * radius / 2 - 1).max() > 0.2


@pytest.mark.sampled(5)
@pytest.mark.parametrize("within", [0.3, 2.0])
@pytest.mark.parametrize("spacing", [SPACING, (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("shape", MEASURED)
def test_measured_shares_and_areas_as_the_reference(shape, spacing, within):
    """Of rough surfaces, whatever the distance within which the curvature is asked for."""
    psi = reference.smooth_noise(shape, 3, 1.2)
    closest_point, gradient = down_the_gradient(psi, spacing)
    part, area, _ = measured(psi, spacing, closest_point, within)
    steep = np.linalg.norm(gradient, axis=1) > 0.1
    d = psi.ravel().astype(float)
    # The plane is that of the mean of psi over the voxel.
    second = np.einsum(
        "...aa,a->...", reference.derivatives(psi, spacing)[1], np.square(spacing)
    ).ravel()
    # Cut at all only where the surface is within half a diagonal of the centre.
    mean = np.where(
        np.abs(d) <= 0.51 * np.linalg.norm(spacing), d + second / 24, np.sign(d) * np.inf
    )
    for s in np.flatnonzero(steep):
        want = (
            reference.cut_voxel(mean[s], gradient[s], spacing)[0]
            if np.isfinite(mean[s])
            else float(d[s] < 0)
        )
        assert part[s] == pytest.approx(want, abs=5e-4)
    assert 0.1 < part.mean() < 0.9
    voxels = np.linalg.norm(closest_point / spacing, axis=1)
    per_mm = (
        np.linalg.norm(gradient / spacing, axis=1)[steep] / np.linalg.norm(gradient, axis=1)[steep]
    )
    delta = np.where(voxels < 1.5, 1 + np.cos(np.pi * voxels / 1.5), 0)[steep] / 3 * per_mm
    gauss = reference.principal_curvatures(psi, spacing).reshape(-1, 2).prod(axis=1)[steep]
    want = delta * (1 - np.clip(d[steep] ** 2 * gauss, -0.25, 0.25)) * np.prod(spacing)
    # The gradient and K are float32, 0.1 steep at least: K to 23 roundings times some 1/0.1^2 of its terms.
    np.testing.assert_allclose(area[steep], want, rtol=1e-3, atol=1e-6)
    assert want.max() > 0.1


@pytest.mark.parametrize("direction", [(0.3, -0.7, 0.65), (1 / 3.0, 1, 1 / 0.7)])
@pytest.mark.parametrize("shape", [(7, 9, 8), (1, 9, 12), (2, 5, 6)])
def test_measures_of_a_plane_are_exact_up_to_the_border(shape, direction):
    """Shares add up to the volume on one side, areas to the polygon that the plane cuts out of the box."""
    n = np.array(direction)
    if shape[0] == 1:
        n[0] = 0  # kernels see no slope across a single slice
    n /= np.linalg.norm(n)
    centre = (np.array(shape) - 1) / 2 * SPACING
    z, y, x = reference.coordinates(shape, SPACING, centre)
    psi = (n[0] * z + n[1] * y + n[2] * x - 0.15).astype(np.float32)
    part, area, bend = measured(psi, SPACING, -psi.reshape(-1, 1) * n, 2.0)
    box = np.array(shape) * SPACING
    want_part, want_area = reference.cut_voxel(-0.15, n, box)
    assert part.sum() * np.prod(SPACING) == pytest.approx(want_part * box.prod(), rel=1e-4)
    # The layer that the area is measured in is cut off at the border, on one side more than on the other.
    assert area.sum() == pytest.approx(want_area, rel=0.05)
    each = [reference.cut_voxel(float(d), n, SPACING)[0] for d in psi.ravel()]
    np.testing.assert_allclose(part, each, atol=4e-4)
    # Second differences of rounded values are not 0: three of psi's roundings, over h^2.
    assert (
        np.abs(bend).max()
        < 3 * 4 * np.finfo(np.float32).eps * np.abs(psi).max() / min(SPACING) ** 2
    )


@pytest.mark.parametrize("closest_points", [True, False])
def test_measures_reach_the_corners_of_the_voxels(closest_points):
    """A plane across the diagonal cuts off the last corner of voxels half a diagonal away."""
    shape, n = (6, 7, 8), np.full(3, 1 / np.sqrt(3))
    z, y, x = reference.coordinates(shape, (1, 1, 1), (2.5, 3.0, 3.5))
    psi = ((z + y + x - 0.4) / np.sqrt(3)).astype(np.float32)
    part, _, _ = measured(psi, (1, 1, 1), -psi.reshape(-1, 1) * n if closest_points else None, 0.1)
    want = np.array([reference.cut_voxel(float(d), n, (1, 1, 1))[0] for d in psi.ravel()])
    far = np.abs(psi.ravel()) > 0.75
    assert (want[far] * (1 - want[far])).max() > 1e-4
    np.testing.assert_allclose(part, want, atol=1e-4)


def test_measures_reach_the_corners_of_very_unequal_voxels():
    """There half a diagonal is more voxels along the normal than the area's layer or the curvature's is wide."""
    shape, spacing, n = (5, 8, 13), (6.0, 1.0, 0.5), np.array((0.5, 0.2, 0.85))
    n /= np.linalg.norm(n)
    z, y, x = reference.coordinates(shape, spacing, (np.array(shape) - 1) / 2 * spacing)
    psi = (n[0] * z + n[1] * y + n[2] * x - 0.1).astype(np.float32)
    part, area, _ = measured(psi, spacing, -psi.reshape(-1, 1) * n, 0.5)
    want = np.array([reference.cut_voxel(float(d), n, spacing)[0] for d in psi.ravel()])
    far = np.abs(psi.ravel()) * np.linalg.norm(n / spacing) > 1.6
    assert (want[far] * (1 - want[far])).max() > 0.01
    np.testing.assert_allclose(part, want, atol=1e-4)
    assert not area[far].any()


def test_where_psi_is_flat_a_voxel_is_in_or_out_and_not_bent():
    for value in (-0.5, 0.5):
        part, _, bend = measured(np.full((5, 6, 7), value), SPACING, np.full((210, 3), 0.5), 2.0)
        assert (part == (value < 0)).all()
        assert not bend.any()


def test_a_sheet_through_voxel_centres_has_a_finite_area():
    """Thin as can be: centred differences on it are 0, and its closest point too short to tell a normal."""
    psi = np.broadcast_to(np.abs(np.arange(9) - 4.0) - 0.001, (5, 6, 9)).astype(np.float32)
    closest_point = np.zeros((*psi.shape, 3))
    closest_point[..., 2] = np.where(np.arange(9) < 4, 1, -1) * psi
    part, area, _ = measured(psi, (1.0, 1.0, 1.0), closest_point, 2.0)
    # Closer together than their layers are wide, its two faces of 30 mm2 each count as one.
    assert area.sum() == pytest.approx(30, rel=0.01)
    assert (part[psi.ravel() > 0.9] == 0).all()


@pytest.mark.parametrize(("start", "stop"), [(40, 50), (0, 130), (100, 301), (7, 7)])
def test_measures_write_nothing_outside_their_range(start, stop):
    psi = reference.smooth_noise((7, 9, 8), 6)
    closest_point, _ = down_the_gradient(psi, SPACING)
    dense, band = reference.whole_band(psi, closest_point)
    n, grid = psi.size, reference.grid_of(psi.shape, SPACING)
    written = unwritten(n)
    region.measure_band(start, stop, dense.psi, grid, band, 2.0, written)
    for out in written:
        assert (
            np.isfinite(out[start:stop]).all()
            and np.isnan(out[:start]).all()
            and np.isnan(out[stop:]).all()
        )


def test_measures_are_the_same_bytes_however_the_range_is_cut():
    psi = reference.smooth_noise((9, 10, 13), 7)
    closest_point, _ = down_the_gradient(psi, SPACING)
    dense, band = reference.whole_band(psi, closest_point)
    n, grid = psi.size, reference.grid_of(psi.shape, SPACING)
    whole, parts = all_measured(psi, SPACING, closest_point, 1.0), unwritten(n)
    for start, stop in itertools.pairwise([0, 1, 8, 130, 300, 301, 557, n]):
        region.measure_band(start, stop, dense.psi, grid, band, 1.0, parts)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)


def test_area_and_curvature_of_many_cells_are_those_of_single_ones():
    """Up to float32: a cell at the border is measured alone, and must not differ from its neighbours."""
    rng, grid = np.random.default_rng(31), reference.grid_of((9, 9, 9), (2.0, 1.0, 0.7))
    memory = rng.normal(0, 0.6, 25 * BATCH).astype(np.float32)
    columns = memory[19 * BATCH :].reshape(6, BATCH)
    distance, voxels = (
        rng.uniform(-1.5, 1.5, BATCH).astype(np.float32),
        rng.uniform(0.011, 2.0, BATCH),
    )
    measured = np.full(4 * BATCH, region.AREA_WIDTH)
    measured[:BATCH] = voxels
    region.measures_alike(grid, distance, memory, (1.58, 2.9), measured)
    areas, curvatures = measured[2 * BATCH :].reshape(2, BATCH)
    for i in range(BATCH):
        level = tuple(columns[:, i])
        _, area, curvature = region.measures(grid, distance[i], voxels[i], level, 1.58, 0.9, 2.9)
        assert areas[i] == pytest.approx(area, rel=1e-6) and curvatures[i] == pytest.approx(
            curvature, rel=1e-6
        )
    assert 0 < np.count_nonzero(areas) < BATCH and 0 < np.count_nonzero(curvatures) < BATCH
    assert (np.abs(curvatures) == 2.9).any() and (np.abs(curvatures) < 2.9).any()


@pytest.mark.parametrize("epsilon", [1.0, 1.5, 2.5])
def test_smeared_share_is_the_integral_of_the_delta_function(epsilon):
    rng = np.random.default_rng(1)
    closest_point = rng.uniform(-1, 1, (60, 3)) * SPACING * 2
    sign = np.where(rng.random(60) < 0.5, -1.0, 1.0)
    psi = sign * np.linalg.norm(closest_point, axis=1)
    band = Band(np.arange(60), psi.astype(np.float32), closest_point.astype(np.float32))
    part = np.empty(60)
    region.smear_band(0, 60, reference.grid_of((60, 1, 1), SPACING), band, epsilon, part)
    s = sign * np.linalg.norm(closest_point / SPACING, axis=1)
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
    grid = Grid(4, 5, 13, 1.0, 1.0, 1.0)
    psi, image = rng.standard_normal((2, 4, 65)).astype(np.float32)
    slot = np.where(rng.random((4, 65)) < 0.3, 5, -1).astype(np.int32)
    sums = np.full((4, 3), -7.0)
    region.inside_sums(1, 3, DenseArrays(psi.ravel(), slot.ravel()), image.ravel(), grid, sums)
    for plane in (1, 2):
        counted = image[plane][(psi[plane] < 0) & (slot[plane] < 0)].astype(np.float64)
        np.testing.assert_allclose(
            sums[plane], [counted.size, counted.sum(), (counted**2).sum()], rtol=1e-12
        )
    assert (sums[[0, 3]] == -7.0).all(), "planes that were not asked for"
