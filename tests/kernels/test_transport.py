"""Transport: interpolation of vectors, departure points, what is advected, stretch of the area, surface gradient."""

import numpy as np
import pytest

from accelsurf.kernels import transport
from accelsurf.kernels.grid import Band, DenseArrays
from tests.support import reference

pytestmark = pytest.mark.nojit

SPACING = (3.0, 1.3, 0.7)
SHAPES = [(5, 6, 7), (1, 7, 6), (4, 1, 5), (2, 3, 5)]
#: A map x -> F x that turns, shears and stretches, z y x.
AFFINE = np.array([(1.1, 0.3, -0.2), (-0.15, 0.8, 0.25), (0.4, -0.1, 1.3)])


def vectors_of(shape, seed, columns=3, share=1.0, extra=0, hole=None):
    """Random vectors on the ``share`` of the voxels that the band has: (present, on the grid, per slot, slot map).

    The voxel ``hole`` is not among them. ``extra`` of the others have a slot beyond those of the band, as while the
    band is being moved.
    """
    rng = np.random.default_rng(seed)
    present = rng.random(shape) < share
    if hole is not None:
        present[hole] = False
    dense = np.stack(
        [reference.smooth_noise(shape, seed + 1 + c, 1.0) for c in range(columns)], axis=-1
    )
    dense[~present] = 0
    slot = np.full(present.size, -1, np.int32)
    cells = np.flatnonzero(present)
    slot[cells] = np.arange(cells.size)
    others = np.flatnonzero(~present)[:extra]
    slot[others] = cells.size + np.arange(others.size)
    return present, dense, np.ascontiguousarray(dense[present]), slot


def positions(shape, seed, count=25, beyond=0.8):
    """Random positions, some of them beyond the border, two corners and some voxel centres."""
    rng = np.random.default_rng(seed)
    last = np.array(shape) - 1.0
    some = rng.uniform(-beyond, last + beyond, (count, 3))
    return np.concatenate([some, [np.zeros(3), last], np.round(np.clip(some[:5], 0, last))])


def scratch():
    return np.full(24, np.nan), np.full(3, np.nan)


def random_normals(n, seed):
    normal = np.random.default_rng(seed).standard_normal((n, 3))
    return (normal / np.linalg.norm(normal, axis=1)[:, None]).astype(np.float32)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def indices(shape):
    return np.argwhere(np.ones(shape, bool)).astype(float)


# ------------------------------------------------------------------------------------------------- vectors of a band


@pytest.mark.sampled
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("columns", [1, 3, 4])
def test_vectors_are_cubic_in_a_complete_band_and_continued_to_the_faces_of_the_border(
    shape, columns
):
    present, dense, values, slot = vectors_of(shape, 1, columns)
    grid, got = reference.grid_of(shape, SPACING), np.full(columns, np.nan)
    for p in positions(shape, 2):
        assert transport.has_stencil(slot, grid, p, np.empty(24))
        assert transport.band_vector_at(values, slot, grid, p, np.full(24, np.nan), got)
        want, _ = reference.band_vector(dense, present, p)
        np.testing.assert_allclose(got, want, atol=2e-5)


@pytest.mark.parametrize("share", [1.0, 0.9])
@pytest.mark.parametrize("shape", SHAPES)
def test_four_fields_at_once_have_the_bytes_of_any_number(shape, share):
    """With a fifth field they take the way of any number."""
    _, _, values, slot = vectors_of(shape, 6, 5, share=share)
    grid, four, five = reference.grid_of(shape, SPACING), np.full(4, np.nan), np.full(5, np.nan)
    for p in positions(shape, 7, 60):
        found = transport.band_vector_at(values, slot, grid, p, np.full(24, np.nan), five)
        first = np.ascontiguousarray(values[:, :4])
        assert transport.band_vector_at(first, slot, grid, p, np.full(24, np.nan), four) == found
        np.testing.assert_array_equal(four, five[:4])


@pytest.mark.parametrize("columns", [3, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_vectors_fall_back_on_the_known_of_the_eight(shape, columns):
    """Not on slots that are not of these values either."""
    present, dense, values, slot = vectors_of(shape, 3, columns, share=0.4, extra=5)
    grid, got = reference.grid_of(shape, SPACING), np.full(columns, np.nan)
    missing = 0
    for p in positions(shape, 4, 40):
        linear = [reference.known_linear(dense[..., c], present, p) for c in range(columns)]
        found = transport.linear_band_vector(values, slot, grid, p, got)
        assert found == linear[0][1]
        if found:
            np.testing.assert_allclose(got, [value for value, _ in linear], atol=1e-5)
        want, want_found = reference.band_vector(dense, present, p)
        assert (
            transport.band_vector_at(values, slot, grid, p, np.full(24, np.nan), got) == want_found
        )
        if want_found:
            np.testing.assert_allclose(got, want, atol=2e-5)
        missing += not found
    assert missing > 0


@pytest.mark.parametrize("columns", [3, 4])
def test_one_missing_node_is_enough_for_the_linear_fall_back(columns):
    shape, p = (5, 6, 7), np.array([1.4, 2.3, 3.6])
    _, dense, values, slot = vectors_of(shape, 5, columns)
    grid, cubic, got = reference.grid_of(shape, SPACING), np.empty(columns), np.empty(columns)
    transport.band_vector_at(values, slot, grid, p, np.empty(24), cubic)
    corner = int(np.ravel_multi_index((3, 4, 5), shape))  # the last of the 4 x 4 x 4
    assert transport.has_stencil(slot, grid, p, np.empty(24))
    # One slot too many for the values: it is not in their band, though the map knows it.
    for held in (-1, len(values)):
        slot[corner] = held
        assert transport.has_stencil(slot, grid, p, np.empty(24)) == (held >= 0)
        assert transport.band_vector_at(values, slot, grid, p, np.empty(24), got)
        want = [reference.linear(dense[..., c], p)[0] for c in range(columns)]
        np.testing.assert_allclose(got, want, atol=1e-5)
        assert np.abs(got - cubic).max() > 1e-3


@pytest.mark.parametrize("shape", SHAPES)
def test_the_stencil_is_the_nodes_of_the_interpolation_and_no_others(shape):
    """With a single hole anywhere."""
    grid, rng = reference.grid_of(shape, SPACING), np.random.default_rng(6)
    seen = set()
    for p in positions(shape, 7):
        present = np.ones(shape, bool)
        present.flat[rng.integers(present.size)] = False
        slot = np.where(present, 0, -1).astype(np.int32).ravel()
        want = reference.has_stencil(present, p)
        assert transport.has_stencil(slot, grid, p, np.full(24, np.nan)) == want
        seen.add(want)
    assert False in seen


# ------------------------------------------------------------------------------------------------- departure points


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_departure_as_the_reference(shape, share):
    present, dense, values, slot = vectors_of(shape, 8, share=share, extra=3)
    grid, at = reference.grid_of(shape, SPACING), np.full(3, np.nan)
    stayed = 0
    for target in positions(shape, 9):
        transport.departure_point(values, slot, grid, target, 0.4, scratch(), at)
        want = reference.departure(dense, present, SPACING, target, 0.4)
        np.testing.assert_allclose(at, want, atol=1e-4)
        stayed += np.array_equal(at, target)
    assert (stayed > 0) == (share < 1)


def test_departure_inverts_an_affine_motion():
    """At + dt V(at) = target, to (dt |grad V|)^4 of the way; not target - dt V(target)."""
    shape, dt = (5, 6, 7), 0.1
    grid, h = reference.grid_of(shape, SPACING), np.array(SPACING)
    slope, middle = (AFFINE - np.eye(3)) * 2, np.array([2.0, 2.5, 3.0])
    values = ((indices(shape) - middle) * h @ slope.T).astype(np.float32)
    slot, at = np.arange(len(values), dtype=np.int32), np.empty(3)
    for target in positions(shape, 10, beyond=-1.0)[:25]:
        transport.departure_point(values, slot, grid, target, dt, scratch(), at)
        moved = at + dt * (slope @ ((at - middle) * h)) / h
        far = np.abs(target - middle).max()
        assert np.abs(moved - target).max() < 2e-3 * far
    straight = target - dt * (slope @ ((target - middle) * h)) / h
    assert np.abs(straight - at).max() > 1e-2


def test_departure_goes_no_further_than_two_voxels_back_along_any_axis():
    shape = (9, 9, 9)
    grid, slot = reference.grid_of(shape, SPACING), np.arange(9**3, dtype=np.int32)
    values = np.tile(np.array([30.0, -50.0, 0.7], np.float32), (9**3, 1))
    at = np.empty(3)
    transport.departure_point(values, slot, grid, np.array([4.0, 4.0, 4.0]), 1.0, scratch(), at)
    np.testing.assert_allclose(at, [2, 6, 3], atol=1e-6)


def test_departure_stays_where_nothing_is_known():
    shape, target, at = (4, 5, 6), np.array([1.3, 2.2, 3.1]), np.empty(3)
    slot = np.full(120, -1, np.int32)
    grid = reference.grid_of(shape, SPACING)
    transport.departure_point(np.ones((3, 3), np.float32), slot, grid, target, 1.0, scratch(), at)
    np.testing.assert_array_equal(at, target)


# ---------------------------------------------------------------------------------------------------- psi is advected


def plane_band(shape, normal, offset, share=1.0, seed=0):
    """(psi on the grid, lattice, band, mask) of a plane's distance; ``share`` of the voxels in the band."""
    psi = (indices(shape) * SPACING) @ normal - offset
    present = np.random.default_rng(seed).random(len(psi)) < share
    slot, cells = np.full(len(psi), -1, np.int32), np.flatnonzero(present)
    slot[cells] = np.arange(cells.size)
    closest_point = (-psi[:, None] * normal).astype(np.float32)
    band = Band(cells, psi[cells].astype(np.float32), closest_point[cells])
    return psi, DenseArrays(psi.astype(np.float32), slot), band, present


@pytest.mark.sampled
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.99, 0.5])
def test_a_plane_is_translated_exactly(shape, share):
    """Up to the border, out through it and in from it, and where the band ends."""
    thick = np.array(shape) > 1
    normal = unit(np.array([0.5, -0.6, 0.7]) * thick)
    psi, dense, band, _ = plane_band(shape, normal, 1.0, share)
    dt = 0.5
    for velocity in (np.array([1.2, -0.9, 0.5]), np.array([-1.2, 0.9, -0.5])):
        moves = np.tile((velocity * thick).astype(np.float32), (band.cells.size, 1))
        out = np.full(band.cells.size, np.nan, np.float32)
        transport.advect_psi(
            0, out.size, dense, reference.grid_of(shape, SPACING), band, moves, dt, out
        )
        np.testing.assert_allclose(
            out, psi[band.cells] - dt * normal @ (velocity * thick), atol=2e-5
        )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("share", "hole"), [(1.0, None), (1.0, (0, 0, 0)), (0.5, None)])
def test_psi_is_that_of_the_departure_point_or_moved_along_the_normal(shape, share, hole):
    present, flow, velocity, slot = vectors_of(shape, 11, share=share, hole=hole)
    rng, grid, dt = np.random.default_rng(12), reference.grid_of(shape, SPACING), 0.3
    cells, psi = np.flatnonzero(present), 2 * reference.smooth_noise(shape, 13)
    # Closest points somewhere at the distance of psi: where a reference takes the gradient for the closest point, it
    # differs.
    d = psi.ravel()[cells]
    way = random_normals(cells.size, 14)
    band = Band(cells, d, -d[:, None] * way)
    psi = psi + rng.uniform(-0.1, 0.1, shape).astype(np.float32)
    out = np.full(cells.size, np.nan, np.float32)
    transport.advect_psi(
        0, cells.size, DenseArrays(psi.ravel().copy(), slot), grid, band, velocity, dt, out
    )
    gradient = unit(reference.derivatives(psi, SPACING)[0].reshape(-1, 3)[cells])
    seen = set()
    for s, target in enumerate(np.argwhere(present)):
        at = reference.departure(flow, present, SPACING, target, dt)
        if reference.has_stencil(present, at):
            want, kind = reference.interpolate(psi, at)[0][0], "advected"
        elif abs(d[s]) > 0.5 * min(SPACING):
            want, kind = d[s] - dt * velocity[s] @ way[s], "foot"
        else:
            want, kind = d[s] - dt * velocity[s] @ gradient[s], "gradient"
        assert out[s] == pytest.approx(want, rel=1e-5, abs=1e-4), kind
        seen.add(kind)
    if shape == SHAPES[0]:
        assert ("advected" in seen) == (share == 1)
        assert ("foot" in seen) == (share < 1 or hole is not None)
        assert ("gradient" in seen) == (share < 1)


def test_outward_normals_on_either_side_and_at_the_surface():
    """From the closest point, and where that is within half a voxel from the gradient."""
    shape, centre = (7, 12, 15), np.array([9.1, 5.4, 5.2])
    grid = reference.grid_of(shape, SPACING)
    off = indices(shape) * SPACING - centre
    radius = np.linalg.norm(off, axis=1)
    psi = (radius - 3.3).reshape(shape)
    radial = unit(off)
    dense, band = reference.whole_band(psi, -psi.reshape(-1, 1) * radial)
    gradient = unit(reference.derivatives(psi, SPACING)[0].reshape(-1, 3))
    far = np.abs(psi.ravel()) > 0.5 * min(SPACING)
    assert (far & (psi.ravel() < 0)).any() and (far & (psi.ravel() > 0)).any() and not far.all()
    for s, (iz, iy, ix) in enumerate(np.ndindex(shape)):
        got = transport.outward(dense.psi, band, s, s, iz, iy, ix, grid)
        np.testing.assert_allclose(got, radial[s] if far[s] else gradient[s], atol=2e-4)
        assert far[s] or np.dot(got, radial[s]) > 0.9


# -------------------------------------------------------------------------------------------------- normals, slopes


@pytest.mark.parametrize("shape", SHAPES)
def test_normals_point_against_the_gradient(shape):
    """Close to the surface, where the way to the closest point is too short to tell."""
    psi = 0.05 * reference.smooth_noise(shape, 15)
    dense, band = reference.whole_band(psi)
    out = np.full((psi.size, 3), np.nan, np.float32)
    transport.normals(0, psi.size, dense.psi, reference.grid_of(shape, SPACING), band, out)
    gradient, _ = reference.derivatives(psi, SPACING)
    np.testing.assert_allclose(out, -unit(gradient.reshape(-1, 3)), atol=1e-4)


def test_normals_point_inwards_on_both_sides():
    shape, normal = (3, 4, 5), unit(np.array([1.0, 2.0, -2.0]))
    _, dense, band, _ = plane_band(shape, normal, 1.0)
    assert band.psi.min() < -0.5 and band.psi.max() > 0.5
    out = np.empty((60, 3), np.float32)
    transport.normals(0, 60, dense.psi, reference.grid_of(shape, SPACING), band, out)
    np.testing.assert_allclose(out, np.tile(-normal, (60, 1)), atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_slopes_and_neighbouring_slots_with_holes_and_at_the_border(shape, share):
    present, dense, values, slot = vectors_of(shape, 17, 2, share)
    grid, near, at = reference.grid_of(shape, SPACING), np.empty(6, np.int64), np.empty(6, np.int64)
    want = [reference.known_slopes(dense[..., c], present, SPACING)[present] for c in range(2)]
    slots = np.pad(slot.reshape(shape), 1, constant_values=-1)
    for s, cell in enumerate(np.argwhere(present)):
        transport.near_slots(slot, grid, int(np.ravel_multi_index(cell, shape)), *cell, near, at)
        steps = np.repeat(np.eye(3, dtype=int), 2, axis=0) * np.array([-1, 1] * 3)[:, None]
        np.testing.assert_array_equal(at, slots[tuple((cell + 1 + steps).T)])
        for c in range(2):
            got = [
                transport.slope(values, c, s, at[2 * a], at[2 * a + 1], h)
                for a, h in enumerate(SPACING)
            ]
            np.testing.assert_allclose(got, want[c][s], rtol=1e-4, atol=1e-5)


def test_slope_of_a_lone_cell_is_zero():
    assert transport.slope(np.array([[3.0]]), 0, 0, -1, -1, 0.7) == 0


# -------------------------------------------------------------------------------------------------- area's stretch


def stretched(shape, velocity, normal, front, dt, slot=None):
    cells = np.arange(int(np.prod(shape))) if slot is None else np.flatnonzero(slot >= 0)
    slot = cells.astype(np.int32) if slot is None else slot
    out = np.full(cells.size, np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    transport.area_stretch(0, cells.size, slot, grid, cells, front, (velocity, normal, dt), out)
    return out


@pytest.mark.sampled
@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(AFFINE, id="affine"),
        pytest.param(np.eye(3), id="at rest"),
        pytest.param(np.diag([1.5, 0.8, 1.1]), id="stretch"),
        pytest.param(np.eye(3) + 0.6 * np.outer([0, 0, 1], [1, 0, 0]), id="shear"),
        pytest.param(np.diag([1.2, 1.3, 0.0]), id="tangent_foot"),
        pytest.param(np.diag([1, -1, -1.0]), id="half turn"),
    ],
)
@pytest.mark.parametrize("shape", [(4, 5, 6), (1, 5, 6), (2, 3, 4)])
def test_stretch_of_affine_maps_is_exact(matrix, shape):
    """J = |cof(F) n|, the area of the image of a unit square: not det F, not |F n|, not of the transpose."""
    dt, n = 0.25, int(np.prod(shape))
    h = np.array(SPACING)
    velocity = ((indices(shape) * h) @ (matrix - np.eye(3)).T / dt).astype(np.float32)
    normal = random_normals(n, 18)
    # Nothing is known of how the velocity changes across a single slice.
    f = np.where(np.array(shape) > 1, matrix, np.eye(3))
    front = np.random.default_rng(19).random(n) < 0.8
    got = stretched(shape, velocity, normal, front, dt)
    want = np.array([reference.area_stretch(f, v) for v in normal])
    np.testing.assert_allclose(got[front], want[front], atol=2e-5)
    assert (got[~front] == 1).all()
    if abs(np.linalg.det(f)) > 0:
        np.testing.assert_allclose(
            want, abs(np.linalg.det(f)) * np.linalg.norm(normal @ np.linalg.inv(f), axis=1)
        )
    if matrix is AFFINE:
        wrong = [
            np.full(n, np.linalg.det(f)),
            np.linalg.norm(normal @ f.T, axis=1),
            np.array([reference.area_stretch(f.T, v) for v in normal]),
            # To first order in dt: 1 + div_S V.
            1 + np.trace(f - np.eye(3)) - np.einsum("ni,ij,nj->n", normal, f - np.eye(3), normal),
        ]
        for other in wrong:
            assert np.abs(other - want)[front].max() > 0.05


def test_stretch_of_surfaces_one_knows():
    """A square in the plane of y and x, normal z: its area by the motion in its plane and by its tilt."""
    shape, n = (3, 4, 5), 60
    z, y, x = (indices(shape) * SPACING).T
    normal, front = np.tile(np.array([1, 0, 0], np.float32), (n, 1)), np.ones(n, bool)
    for velocity, want in (
        ((0 * z, 0.5 * y, 0.2 * x), 1.5 * 1.2),
        ((0.7 * z, 0 * y, 0 * x), 1.0),  # moved along the normal, more so further off: no stretch
        ((0 * z, 0.6 * z, -0.4 * z), 1.0),  # levels slide over one another
        ((0.75 * x, 0 * y, 0 * x), np.hypot(1, 0.75)),  # tilted
        ((0 * z, 0.9 * x, 0 * x), 1.0),  # sheared in its plane
    ):
        got = stretched(shape, np.stack(velocity, axis=1).astype(np.float32), normal, front, 1.0)
        np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.slow
def test_stretch_of_a_growing_sphere():
    """V = n on the sphere of radius r, constant along normals: (1 + dt/r)^2 on the level through each cell."""
    shape, centre, dt = (9, 11, 12), np.array([4.1, 5.2, 5.4]), 0.8
    off = indices(shape) - centre
    radius = np.linalg.norm(off, axis=1)
    normal = unit(off).astype(np.float32)
    front = (radius > 3) & (np.abs(off) < 4).all(axis=1)
    out = np.empty(len(off), np.float32)
    cells = np.arange(len(off))
    grid = reference.grid_of(shape, (1, 1, 1))
    transport.area_stretch(
        0, out.size, cells.astype(np.int32), grid, cells, front, (normal, normal, dt), out
    )
    np.testing.assert_allclose(out[front], ((1 + dt / radius) ** 2)[front], rtol=0.02)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_stretch_as_the_reference_with_holes(shape, share):
    present, dense, velocity, slot = vectors_of(shape, 20, share=share)
    n, dt = len(velocity), 0.4
    normal, front = random_normals(n, 21), np.random.default_rng(22).random(n) < 0.7
    got = stretched(shape, velocity, normal, front, dt, slot)
    slopes = np.stack(
        [reference.known_slopes(dense[..., c], present, SPACING)[present] for c in range(3)], axis=1
    )
    want = [
        reference.area_stretch(np.eye(3) + dt * g, v) for g, v in zip(slopes, normal, strict=True)
    ]
    np.testing.assert_allclose(got[front], np.array(want)[front], rtol=1e-4, atol=1e-4)
    assert (got[~front] == 1).all()


# ------------------------------------------------------------------------------------------------ surface gradient


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_surface_gradient_is_the_tangential_part_with_holes_and_at_the_border(shape, share):
    present, dense, values, slot = vectors_of(shape, 23, 1, share)
    n, cells = len(values), np.flatnonzero(present)
    normal, front = random_normals(n, 24), np.random.default_rng(25).random(n) < 0.7
    out = np.full((n, 3), np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    transport.surface_gradient(0, n, slot, grid, cells, front, (values, normal), out)
    # Projected by two tangents instead of by taking the normal part away.
    slopes = reference.known_slopes(dense[..., 0], present, SPACING)[present]
    tangents = np.array([np.linalg.svd(v[None])[2][1:] for v in normal.astype(float)])
    want = np.einsum("nta,nt->na", tangents, np.einsum("nta,na->nt", tangents, slopes))
    np.testing.assert_allclose(out[front], want[front], rtol=1e-4, atol=1e-5)
    assert np.abs((out * normal).sum(axis=1)).max() < 1e-5
    assert not out[~front].any()


def test_surface_gradient_of_a_linear_field():
    shape, slope = (3, 4, 5), np.array([0.5, -1.0, 2.0])
    values = ((indices(shape) * SPACING) @ slope).astype(np.float32)[:, None]
    cells, front, out = np.arange(60), np.ones(60, bool), np.empty((60, 3), np.float32)
    grid, slot = reference.grid_of(shape, SPACING), cells.astype(np.int32)
    for normal, want in (
        ((1, 0, 0), (0, -1, 2)),
        ((0, 0, -1), (0.5, -1, 0)),
        (unit(slope), (0, 0, 0)),
    ):
        each = np.tile(np.array(normal, np.float32), (60, 1))
        transport.surface_gradient(0, 60, slot, grid, cells, front, (values, each), out)
        np.testing.assert_allclose(out, np.tile(np.array(want, float), (60, 1)), atol=1e-5)


# ------------------------------------------------------------------------------------------------ fields are advected


@pytest.mark.parametrize("shape", SHAPES)
def test_linear_fields_are_carried_from_where_the_closest_point_came_from(shape):
    """By a uniform velocity, in a complete band: the value at closest point - dt V."""
    n, dt, last = int(np.prod(shape)), 0.3, np.array(shape) - 1.0
    rng, h = np.random.default_rng(26), np.array(SPACING)
    slopes = rng.standard_normal((2, 3)) * (last > 0)
    values = (indices(shape) * h @ slopes.T + 1).astype(np.float32)
    uniform = np.array([0.9, -0.4, 0.5])
    velocity = np.tile(uniform.astype(np.float32), (n, 1))
    closest_point = rng.uniform(-1, 1, (n, 3)) * h
    _, band = reference.whole_band(np.ones(shape), closest_point)
    out = np.full((n, 2), np.nan, np.float32)
    grid = reference.grid_of(shape, SPACING)
    transport.advect_fields(
        0, n, np.arange(n, dtype=np.int32), grid, band, (velocity, dt, 2), values, out
    )
    # Clamped to the faces of the border.
    face = np.where(last > 0, 0.5, 0.0)
    at = np.clip(indices(shape) + (closest_point - dt * uniform) / h, -face, last + face) * h
    np.testing.assert_allclose(out, at @ slopes.T + 1, atol=5e-5)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("columns", [1, 4])
@pytest.mark.parametrize("share", [0.95, 0.3])
def test_fields_are_carried_onto_another_band(shape, columns, share):
    """Some of its cells are new, some have nothing known about their departure points; the last column is limited."""
    present, flow, velocity, slot = vectors_of(shape, 27, share=share, extra=4)
    values = np.random.default_rng(28).standard_normal((len(velocity), columns)).astype(np.float32)
    dense = np.zeros((*shape, columns), np.float32)
    dense[present] = values
    rng, dt, grid = np.random.default_rng(29), 0.3, reference.grid_of(shape, SPACING)
    cells = np.flatnonzero(rng.random(present.size) < 0.7)
    closest_point = (rng.uniform(-1.3, 1.3, (cells.size, 3)) * SPACING).astype(np.float32)
    band = Band(cells, np.ones(cells.size, np.float32), closest_point)
    out = np.full((cells.size, columns), np.nan, np.float32)
    transport.advect_fields(
        0, cells.size, slot, grid, band, (velocity, dt, columns - 1), values, out
    )
    seen = set()
    for s, cell in enumerate(indices(shape)[cells]):
        at = reference.departure(
            flow, present, SPACING, cell + closest_point[s].astype(float) / SPACING, dt
        )
        want, found = reference.band_vector(dense, present, at)
        if not found:
            want = dense[tuple(cell.astype(int))]  # 0 where it was not in the band
        else:
            want[-1] = reference.limited(dense[..., -1], present, at, want[-1], transport.LIMIT)
        np.testing.assert_allclose(out[s], want, atol=2e-4)
        seen.add((found, bool(present.flat[cells[s]])))
    assert (True, True) in seen
    if share < 0.5:
        assert seen == {(True, True), (True, False), (False, True), (False, False)}


def test_cells_with_nothing_known_keep_their_own_values_or_get_none():
    """A band of one cell in a corner; of the new band one is that cell, one is new, one was just given a slot."""
    grid = reference.grid_of((5, 6, 7), SPACING)
    slot = np.full(210, -1, np.int32)
    slot[0], slot[3] = 0, 1
    values, velocity = np.array([[5.0, -6.0]], np.float32), np.zeros((1, 3), np.float32)
    far = np.tile(np.array([9.0, 3.0, 2.8], np.float32), (3, 1))
    band = Band(np.array([0, 1, 3]), np.ones(3, np.float32), far)
    out = np.full((3, 2), np.nan, np.float32)
    transport.advect_fields(0, 3, slot, grid, band, (velocity, 0.5, 2), values, out)
    np.testing.assert_array_equal(out, [[5, -6], [0, 0], [0, 0]])
    # With their closest points beside the cell all three have its values.
    band.to_closest[:] = np.array([[0.3, 0.2, 0.1], [0.3, 0.2, -0.6], [0.3, 0.2, -2.0]], np.float32)
    transport.advect_fields(0, 3, slot, grid, band, (velocity, 0.5, 2), values, out)
    np.testing.assert_allclose(out, np.tile(values, (3, 1)), atol=1e-6)


def test_a_positive_field_stays_positive_where_it_jumps():
    """From 1 to 1e-3 in a voxel: the cubic interpolant is below 0 beside it. Only the second column is limited."""
    n, grid = 12, reference.grid_of((1, 1, 12), (1.0, 1.0, 1.0))
    values = np.where(np.arange(n) < 6, 1.0, 1e-3).astype(np.float32)
    slot, shift = np.arange(n, dtype=np.int32), np.zeros((n, 3), np.float32)
    shift[:, 2] = 0.4
    _, band = reference.whole_band(np.ones((1, 1, n)), np.zeros((n, 3)))
    out = np.empty((n, 2), np.float32)
    both = np.stack([values, values], axis=1)
    transport.advect_fields(0, n, slot, grid, band, (shift, 1.0, 1), both, out)
    assert out[:, 0].min() < -0.01 and out[:, 0].max() > 1.01
    assert 0.9e-3 <= out[:, 1].min() and out[:, 1].max() <= 1.1
    # A smooth field is not touched.
    smooth = np.exp(-0.2 * (np.arange(n) - 5.3) ** 2 / 9).astype(np.float32)
    transport.advect_fields(
        0, n, slot, grid, band, (shift, 1.0, 1), np.stack([smooth, smooth], axis=1), out
    )
    np.testing.assert_array_equal(out[:, 0], out[:, 1])


def test_kernels_write_only_their_range():
    shape, n = (3, 4, 5), 60
    grid, normal = reference.grid_of(shape, SPACING), random_normals(60, 30)
    _, dense, band, _ = plane_band(shape, unit(np.array([1.0, 2.0, 3.0])), 2.0)
    velocity, field, front = (
        np.ones((n, 3), np.float32),
        np.ones((n, 1), np.float32),
        np.ones(n, bool),
    )
    wide, flat = np.full((n, 3), np.nan, np.float32), np.full(n, np.nan, np.float32)
    transport.advect_psi(7, 20, dense, grid, band, velocity, 0.1, flat)
    assert np.isfinite(flat[7:20]).all() and np.isnan(flat[:7]).all() and np.isnan(flat[20:]).all()
    flat[:] = np.nan
    transport.area_stretch(
        7, 20, dense.slot, grid, band.cells, front, (velocity, normal, 0.1), flat
    )
    assert np.isfinite(flat[7:20]).all() and np.isnan(flat[:7]).all() and np.isnan(flat[20:]).all()
    for call in (
        lambda out: transport.normals(7, 20, dense.psi, grid, band, out),
        lambda out: transport.surface_gradient(
            7, 20, dense.slot, grid, band.cells, front, (field, normal), out
        ),
        lambda out: transport.advect_fields(
            7, 20, dense.slot, grid, band, (velocity, 0.1, 3), velocity, out
        ),
    ):
        wide[:] = np.nan
        call(wide)
        assert (
            np.isfinite(wide[7:20]).all() and np.isnan(wide[:7]).all() and np.isnan(wide[20:]).all()
        )


@pytest.mark.parametrize("shape", SHAPES)
def test_fields_go_over_to_another_grid(shape):
    """The linear value among what is known around the closest point, on a grid of other voxels; elsewhere what is asked
    for.
    """
    present, dense, values, slot = vectors_of(shape, 31, columns=2, share=0.5)
    other, rng = (7, 9, 10), np.random.default_rng(32)
    grid, cells = reference.grid_of(other, (1.0, 0.5, 0.8)), np.flatnonzero(rng.random(630) < 0.6)
    closest_point = rng.uniform(-1.0, 1.0, (cells.size, 3)).astype(np.float32)
    band = Band(cells, np.ones(cells.size, np.float32), closest_point)
    place = np.array([(0.5, 0.7, 0.4), (-0.25, 0.1, 0.3)])
    fields, absent = np.ascontiguousarray(values.T), np.array([7, -8], np.float32)
    out = np.full((2, cells.size), np.nan, np.float32)
    coarse = (slot, reference.grid_of(shape, SPACING))
    transport.fields_between(0, cells.size, coarse, band, grid, place, (fields, absent), out)
    known = 0
    for s, cell in enumerate(indices(other)[cells]):
        at = (cell + closest_point[s] / np.array([1.0, 0.5, 0.8])) * place[0] + place[1]
        for field in range(2):
            want, found = reference.known_linear(dense[..., field], present, at)
            known += found
            np.testing.assert_allclose(out[field, s], want if found else absent[field], atol=2e-5)
    assert 0 < known < out.size
