"""The level set: distance, extension, motion, borders, topology, against exact distances and slow references."""

import os

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.kernels.closest import FIRST_TOLERANCE
from accelsurf.kernels.grid import DenseArrays
from accelsurf.levelset import LevelSet
from tests.support import reference
from tests.support.level_set_checks import check_level_set

ISOTROPIC, UNEQUAL = (1.0, 1.0, 1.0), (3.0, 1.0, 0.7)


def coordinates(shape, spacing, off=(0.3, -0.2, 0.1)):
    """(z, y, x) in mm from a point ``off`` mm from the volume's centre."""
    centre = (np.array(shape) - 1) / 2 * spacing + np.array(off)
    return reference.coordinates(shape, spacing, centre)


def ball(shape, spacing, radius, off=(0.3, -0.2, 0.1)):
    z, y, x = coordinates(shape, spacing, off)
    return np.sqrt(z**2 + y**2 + x**2) - radius


def torus(shape, spacing, large, small, off=(0.3, -0.2, 0.1)):
    z, y, x = coordinates(shape, spacing, off)
    return np.hypot(np.hypot(y, x) - large, z) - small


def plane(shape, spacing, direction, offset):
    n = np.array(direction) / np.linalg.norm(direction)
    z, y, x = coordinates(shape, spacing)
    return n[0] * z + n[1] * y + n[2] * x - offset


def volume(surface):
    return surface.volume(surface.fraction_and_area()[0])


def area(surface):
    return surface.fraction_and_area()[1].sum()


def in_band(surface):
    return (surface.dense.slot >= 0).reshape(surface.shape)


def depth(surface):
    """Distance from the surface in voxels along the normal, (nz, ny, nx); 0 outside the band."""
    out = np.zeros(surface.dense.psi.size)
    out[surface.band.cells] = np.linalg.norm(surface.band.to_closest / surface.grid[3:], axis=1)
    return out.reshape(surface.shape)


def redistanced(surface, times):
    for _ in range(times):
        surface.redistance()
    return surface


def objects(surface):
    return ndimage.label(surface.labels)[1]


def steps(surface, speed, dt, count, checks=8):
    """Advance with speeds given by a function of the surface; checked after each step.

    Checks 7 and 8 are averages over the front: a surface of a few voxels, or a rough one, may miss them.
    """
    for _ in range(count):
        surface.advance(np.asarray(speed(surface), np.float32), dt)
        surface.remove_small()
        surface.redistance()
        assert check_level_set(surface, checks) == []


def constant(value):
    return lambda surface: np.full(surface.size, value)


# --------------------------------------------------------------------------------------------------- convergence

SIZES = (24, 32, 48, 64)


def exact_case(name, n):
    """Exact distance in a box of side 2, the middle off every symmetry of the grid."""
    shape, h = (n, n, n), 2.0 / n
    off = (0.3 * h, -0.2 * h, 0.1 * h)
    if name == "ball":
        return ball(shape, (h, h, h), 0.6, off), h
    if name == "torus":
        return torus(shape, (h, h, h), 0.55, 0.3, off), h
    return plane(shape, (h, h, h), (0.3, 0.8, 0.52), 0.02), h


def order(errors):
    """Slope of log error over log n, by least squares."""
    return -np.polyfit(np.log(SIZES), np.log(errors), 1)[0]


@pytest.mark.parametrize("given", ["distance", "other"])
@pytest.mark.parametrize("name", ["ball", "torus"])
def test_distance_converges_to_the_exact_one(name, given):
    """Mean error within 1.5 voxels of the surface, from the distance itself and from a function that is none."""
    means, worst = [], []
    for n in SIZES:
        exact, h = exact_case(name, n)
        z, y, x = coordinates(exact.shape, (h, h, h))
        surface = redistanced(
            LevelSet(exact * (1 if given == "distance" else 1 + 0.4 * x + 0.3 * y * z), (h, h, h)),
            1,
        )
        near = np.abs(exact) < 1.5 * h
        error = np.abs(surface.psi - exact)[near]
        means.append(error.mean())
        worst.append(error.max() / h)
    print(
        f"{name} from {given}: mean error / h",
        *(f"{e * n / 2:.1e}" for e, n in zip(means, SIZES, strict=True)),
    )
    print(
        f"  order of the mean error {order(means):.2f}; largest error / h",
        *(f"{e:.1e}" for e in worst),
    )
    assert order(means) >= 1.8
    assert means[-1] * SIZES[-1] / 2 < 5e-4
    assert worst[-1] < 0.02


def test_distance_of_a_plane_is_exact_up_to_the_border():
    exact, h = exact_case("plane", 32)
    surface = LevelSet(exact, (h, h, h))
    assert in_band(surface)[np.abs(exact) < 2.9 * h].all()
    near = np.abs(exact) < 1.5 * h
    inner = np.zeros(exact.shape, bool)
    inner[3:-3, 3:-3, 3:-3] = True
    assert np.abs(surface.psi - exact)[near | (in_band(surface) & inner)].max() < 1e-5 * h
    error = np.abs(redistanced(surface, 3).psi - exact)
    assert error[inner & in_band(surface)].max() < 1e-5 * h
    assert error[near].max() < 0.01 * h
    # Where the closest point lies beyond the border, and stencils at the border leave the band.
    assert error[in_band(surface)].max() < 0.2 * h


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_distance_as_the_slow_reference_on_random_smooth_surfaces(seed):
    shape, spacing = (17, 22, 20), (1.3, 1.0, 0.9)
    psi = 4 * (reference.smooth_noise(shape, seed, 3.0) - np.float32(0.3))
    surface = LevelSet(psi, spacing)
    # Away from the border, where the closest point may lie beyond it, and as far as the front is resolved.
    inner = np.zeros(shape, bool)
    inner[3:-3, 3:-3, 3:-3] = True
    cells = np.argwhere(inner & (np.abs(surface.psi) < 2.0) & in_band(surface))[::2]
    want = reference.distance(psi, spacing, cells, 3)
    error = np.abs(surface.psi[tuple(cells.T)] - want)
    print(
        f"{len(cells)} cells: mean {error.mean():.1e}, 99 % {np.quantile(error, 0.99):.1e}, max {error.max():.1e} mm"
    )
    assert len(cells) > 300
    assert np.median(error) < 2e-4
    assert np.quantile(error, 0.9) < 5e-3
    assert error.mean() < 0.01
    # Necks and ridges apart, where the interpolant is steeper or flatter than a distance.
    assert np.quantile(error, 0.99) < 0.2
    # No cell is nearer than the nearest point of the brute force.
    assert (np.abs(surface.psi[tuple(cells.T)]) > np.abs(want) - 0.02).mean() > 0.98


# -------------------------------------------------------------------------------------------------------- at rest


def test_a_ball_at_rest_drifts_less_than_a_200th_voxel_in_100_redistances():
    exact = ball((64, 64, 64), ISOTROPIC, 20.0)
    surface = LevelSet(exact, ISOTROPIC)
    near = np.abs(exact) < 1
    before = volume(surface)
    redistanced(surface, 100)
    drift = np.abs(surface.psi - exact)[near].max()
    print(f"largest drift {drift:.1e} voxel, volume {volume(surface) / before - 1:.1e}")
    assert drift < 0.005
    assert abs(volume(surface) / before - 1) < 1e-4
    assert check_level_set(surface) == []


@pytest.mark.parametrize(
    ("off", "most"),
    [((-16, 0.1, 0.2), 0.01), ((-15.2, 14.6, 0.1), 0.02), ((-14.2, 14.8, 13.9), 0.03)],
)
def test_the_band_at_the_border_is_a_normal_case(off, most):
    """A ball cut by a face, an edge and a corner of the volume: exact at the cuts, and so after 50 redistancings."""
    exact = ball((36, 36, 36), ISOTROPIC, 12.0, off)
    surface = LevelSet(exact, ISOTROPIC)
    near = np.abs(exact) < 1.5
    border = np.ones(exact.shape, bool)
    border[1:-1, 1:-1, 1:-1] = False
    assert (near & border).sum() > 20
    before = volume(surface)
    start = np.abs(surface.psi - exact)[near & border].max()
    redistanced(surface, 50)
    drift = np.abs(surface.psi - exact)
    print(
        f"border: error {start:.1e}, after 50 redistancings {drift[near & border].max():.1e} voxel"
    )
    assert start < most
    assert drift[near].max() < most
    assert abs(volume(surface) / before - 1) < 3e-4
    assert check_level_set(surface) == []


@pytest.mark.parametrize("spacing", [(3.0, 1.0, 1.0), (1.0, 1.0, 3.0), (1.0, 2.0, 0.8)])
def test_an_anisotropic_ball_is_accurate_and_stays(spacing):
    shape = tuple(round(54 / h) for h in spacing)
    exact = ball(shape, spacing, 20.0)
    surface = LevelSet(exact, spacing)
    near = np.abs(exact) < min(spacing)
    start = np.abs(surface.psi - exact)[near].max()
    before = volume(surface)
    redistanced(surface, 30)
    drift = np.abs(surface.psi - exact)[near].max()
    print(
        f"{spacing}: error {start:.1e}, after 30 times {drift:.1e} mm, volume {volume(surface) / before - 1:.1e}"
    )
    assert start < 0.005
    assert drift < 0.05
    assert volume(surface) == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.005)
    assert check_level_set(surface) == []


@pytest.mark.parametrize(
    "off", [(0.3, -0.2, 0.1), (18.3, -0.2, 0.1), (-0.2, 18.3, -17.8), (-17.2, 18.3, -17.8)]
)
@pytest.mark.parametrize("spacing", [(3.0, 1.0, 1.0), (1.0, 1.0, 3.0)])
def test_no_surface_appears_where_there_was_none(spacing, off):
    """Thick slices, a ball of under five of them, cut by the border: psi jumps at the band's end."""
    shape = tuple(round(40 / h) for h in spacing)
    exact = ball(shape, spacing, 14.0, off)
    surface = LevelSet(exact, spacing)
    before = volume(surface)
    redistanced(surface, 50)
    closer = (np.abs(exact) - np.abs(surface.psi))[in_band(surface)]
    assert closer.max() < 3.0
    assert np.abs(surface.psi - exact)[np.abs(exact) < 1].max() < 0.15
    assert volume(surface) == pytest.approx(before, rel=0.01)
    assert check_level_set(surface) == []


# ------------------------------------------------------------------------------------------------------- symmetry


def test_the_other_side_is_the_same_bytes():
    """psi -> -psi."""
    rough = reference.smooth_noise((20, 24, 22), 5, 3.0)
    for psi, spacing in ((rough, UNEQUAL), (ball((20, 20, 20), ISOTROPIC, 7), ISOTROPIC)):
        one, other = LevelSet(psi, spacing), LevelSet(-psi, spacing)
        for _ in range(3):
            np.testing.assert_array_equal(one.psi, -other.psi)
            np.testing.assert_array_equal(one.band.to_closest, other.band.to_closest)
            redistanced(one, 1)
            redistanced(other, 1)


TURNS = {
    "zyx->yzx": lambda a: a.transpose(1, 0, 2),
    "zyx->xzy": lambda a: a.transpose(2, 0, 1),
    "zyx->xyz": lambda a: a.transpose(2, 1, 0),
    "flip z": lambda a: a[::-1],
    "flip y": lambda a: a[:, ::-1],
    "flip x": lambda a: a[:, :, ::-1],
}
PERMUTED = {"zyx->yzx": (1, 0, 2), "zyx->xzy": (2, 0, 1), "zyx->xyz": (2, 1, 0)}


@pytest.mark.parametrize("turn", TURNS)
def test_turned_and_mirrored_surfaces_are_the_same(turn):
    """To 1e-4 mm within two voxels: sums are rounded in another order. Further off the torus has its ridge."""
    spacing = (1.2, 1.0, 0.9)
    turned_spacing = tuple(spacing[a] for a in PERMUTED.get(turn, (0, 1, 2)))
    turned = TURNS[turn]
    for psi in (
        torus((20, 34, 40), spacing, 9.0, 4.5),
        ball((20, 34, 40), spacing, 8.0, (2.0, 3.0, -11.0)),
    ):
        psi = psi.astype(np.float32)
        one, other = (
            redistanced(LevelSet(psi, spacing), 3),
            redistanced(LevelSet(turned(psi), turned_spacing), 3),
        )
        gap = np.abs(turned(one.psi) - other.psi)
        assert gap[np.abs(other.psi) < 2].max() < 1e-4
        assert (gap > 1e-3).mean() < 1e-4
        # In one band and not in the other may only be cells at the very edge, where closest points are known: off a
        # slanted surface their lengths in voxels change as much as they move along it, FIRST_TOLERANCE at a voxel.
        here, there = turned(in_band(one)), in_band(other)
        edge = np.where(here, turned(depth(one)), depth(other))[here != there]
        assert (edge > one.half_width * (1 - FIRST_TOLERANCE)).all()
        assert area(one) == pytest.approx(area(other), rel=1e-6)


@pytest.mark.parametrize("turn", TURNS)
def test_turned_rough_surfaces_differ_at_most_on_their_ridges(turn):
    """Where two points of the surface are equally close, the march may take either."""
    spacing = (1.2, 1.0, 0.9)
    psi = reference.smooth_noise((24, 30, 27), 6, 3.0)
    turned_spacing = tuple(spacing[a] for a in PERMUTED.get(turn, (0, 1, 2)))
    one, other = LevelSet(psi, spacing), LevelSet(TURNS[turn](psi), turned_spacing)
    gap = np.abs(TURNS[turn](one.psi) - other.psi)
    assert (gap > 1e-4).sum() < 0.01 * one.size
    assert volume(one) == pytest.approx(volume(other), rel=1e-5)


# ------------------------------------------------------------------------------------------------------ extension


def wave(shape, spacing, off=(0.3, -0.2, 0.1)):
    """A smooth function on the sphere (constant along its radii)."""
    z, y, x = coordinates(shape, spacing, off)
    r = np.sqrt(z**2 + y**2 + x**2) + 1e-12
    return (x * y / r**2 + 0.7 * z / r - 0.4 * (y / r) ** 3).astype(np.float32)


@pytest.mark.parametrize(("half_width", "least"), [(3.0, (1.7, 0.7)), (4.0, (3.0, 1.8))])
def test_fields_come_back_constant_along_normals(half_width, least):
    """Errors of the field against the exact one, and of grad F . grad psi, over 24..64.

    The given field changes fast along normals. In a band of half width 4 all stencils are cubic; in one of 3 some
    are linear, which costs an order (fields that are nearly constant along normals, as in a run, do not see it).
    """
    errors, slopes = [], []
    for n in SIZES:
        exact, h = exact_case("ball", n)
        off = (0.3 * h, -0.2 * h, 0.1 * h)
        on_sphere = wave(exact.shape, (h, h, h), off)
        surface = LevelSet(exact, (h, h, h), half_width)
        # Anything but constant along the normals.
        skewed = on_sphere * (1 + 2 * exact) + 3 * exact
        (field,) = surface.redistance(
            [skewed.ravel()[surface.band.cells].astype(np.float32)]
        ).fields
        near = np.abs(surface.band.psi) < 2 * h
        errors.append(np.abs(field - on_sphere.ravel()[surface.band.cells])[near].max())
        dense = np.full(exact.size, np.nan)
        dense[surface.band.cells] = field
        dense = dense.reshape(exact.shape)
        dot = sum(
            a * b for a, b in zip(np.gradient(dense, h), np.gradient(surface.psi, h), strict=True)
        )
        slopes.append(np.abs(dot[np.abs(exact) < h]).max())
    print("extension: field error", *(f"{e:.1e}" for e in errors), f"order {order(errors):.2f}")
    print(
        "extension: grad F . grad psi", *(f"{e:.1e}" for e in slopes), f"order {order(slopes):.2f}"
    )
    assert order(errors) >= least[0]
    assert order(slopes) >= least[1]
    assert errors[-1] < 0.003


def test_several_fields_are_extended_at_once_and_the_given_ones_are_kept():
    surface = LevelSet(ball((20, 22, 24), (1.2, 1.0, 1.0), 7.0), (1.2, 1.0, 1.0))
    one = np.ones(surface.size, np.float32)
    other = np.arange(surface.size, dtype=np.float32)
    before = surface.band.cells
    change = surface.redistance([one, other, -other])
    assert [f.dtype for f in change.fields] == [np.float32] * 3
    np.testing.assert_allclose(change.fields[0], 1, rtol=1e-5)
    np.testing.assert_allclose(change.fields[1], -change.fields[2])
    assert (one == 1).all()
    np.testing.assert_array_equal(other, np.arange(before.size))


def test_extend_outwards_keeps_the_front_and_continues_it():
    exact = ball((40, 40, 40), ISOTROPIC, 12.0)
    surface = LevelSet(exact, ISOTROPIC)
    want = wave(exact.shape, ISOTROPIC).ravel()[surface.band.cells]
    front = surface.front()
    values = np.where(front, want, np.float32(9)).astype(np.float32)
    surface.extend_outwards(values, front)
    np.testing.assert_array_equal(values[front], want[front])
    assert (~front).sum() > 1000
    assert np.abs(values - want)[~front].max() < 0.02


@pytest.mark.parametrize("spacing", [ISOTROPIC, (3.0, 1.0, 1.0), (1.0, 2.0, 0.8)])
def test_the_front_is_deep_enough_for_linear_interpolation_at_every_closest_point(spacing):
    """All eight cells around a closest point are in the front, also with thick slices and slanted normals."""
    shape = tuple(round(54 / h) for h in spacing)
    surface = LevelSet(ball(shape, spacing, 20.0), spacing)
    front = np.zeros(shape, bool)
    front.ravel()[surface.band.cells[surface.front()]] = True
    at = (
        np.stack(np.unravel_index(surface.band.cells, shape), axis=1)
        + surface.band.to_closest / spacing
    )
    low = np.floor(at).astype(int)
    missing = [1 - front[tuple((low + corner).T)].mean() for corner in np.ndindex(2, 2, 2)]
    # Nearly: the front is counted along normals, a slanted surface is nearer across.
    assert max(missing) == 0 if spacing == ISOTROPIC else max(missing) < 0.01


# --------------------------------------------------------------------------------------------------------- motion


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_constant_speed_moves_a_ball_by_speed_times_time(speed):
    """beta > 0 shrinks. Ten steps of 0.4 voxel."""
    exact = ball((40, 40, 40), ISOTROPIC, 11.0)
    surface = LevelSet(exact, ISOTROPIC)
    steps(surface, constant(speed), 0.4, 10)
    error = (surface.psi - (exact + 4 * speed))[np.abs(exact + 4 * speed) < 1]
    print(f"moved by 4 voxels: mean error {error.mean():.1e}, max {np.abs(error).max():.1e} voxel")
    assert np.abs(error).max() < 0.05
    assert abs(error.mean()) < 0.03


def test_a_ball_is_carried_along():
    """beta = V . N: 12 steps of 0.4 voxel along a diagonal, unequal spacing."""
    spacing, way, dt = (1.25, 1.0, 0.8), np.array([0.48, 0.6, 0.64]), 0.3
    shape = (34, 42, 50)
    surface = LevelSet(ball(shape, spacing, 9.0, -1.8 * way), spacing)
    before = volume(surface)

    def speed_of(level):
        gradient = np.stack(np.gradient(level.psi, *spacing), axis=-1).reshape(-1, 3)[
            level.band.cells
        ]
        # Constant along normals: taken at the front and extended.
        speed = -(gradient @ way / np.linalg.norm(gradient, axis=1)).astype(np.float32)
        level.extend_outwards(speed, level.front(1.9))
        return speed

    steps(surface, speed_of, dt, 12)
    exact = ball(shape, spacing, 9.0, 1.8 * way)
    error = (surface.psi - exact)[np.abs(exact) < 0.8]
    print(f"advected by 3.6 mm: mean error {error.mean():.1e}, max {np.abs(error).max():.1e} mm")
    assert np.abs(error).max() < 0.1
    assert volume(surface) == pytest.approx(before, rel=0.02)


def test_distance_from_a_snapshot_is_the_shift():
    for exact, spacing, per_voxel in (
        (ball((30, 30, 30), (0.5, 0.5, 0.5), 5.0), (0.5, 0.5, 0.5), 0.5),
        (plane((12, 15, 20), UNEQUAL, (0, 0, 1), 0.1), UNEQUAL, 0.7),
        (plane((16, 15, 20), UNEQUAL, (1, 0, 0), 0.1), UNEQUAL, 3.0),
    ):
        surface = LevelSet(exact, spacing)
        before = surface.snapshot()
        assert surface.distance_from(before) == (0, 0)
        steps(surface, constant(-0.6), per_voxel / 2, 3)
        assert surface.distance_from(before) == (pytest.approx(0.9, abs=0.01), 0)
    surface = LevelSet(ball((30, 30, 30), ISOTROPIC, 9.0), ISOTROPIC)
    before = surface.snapshot()
    steps(surface, constant(-1.0), 0.5, 8)
    # Where the earlier band did not reach, its half width counts; the others are in its outermost part.
    assert surface.distance_from(before) == (pytest.approx(3, abs=0.1), 1)


def test_a_surface_that_shrinks_to_nothing():
    surface = LevelSet(ball((12, 13, 11), ISOTROPIC, 3.0), ISOTROPIC)
    steps(surface, constant(1.0), 0.5, 8, checks=6)
    assert (surface.size, surface.is_filled, volume(surface)) == (0, False, 0)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_surface_that_leaves_the_volume(sign):
    """A ball grows beyond every border, a hole likewise: nothing is left in the band."""
    surface = LevelSet(sign * ball((12, 13, 11), ISOTROPIC, 6.0), ISOTROPIC)
    steps(surface, constant(-sign), 0.5, 12, checks=6)
    assert (surface.labels == (sign > 0)).all()
    assert (surface.size, surface.is_filled) == (0, sign > 0)
    assert volume(surface) == (12 * 13 * 11 if sign > 0 else 0)


@pytest.mark.parametrize("sign", [1, -1])
def test_no_surface_to_begin_with(sign):
    surface = LevelSet(np.full((5, 6, 7), 2.0 * sign), UNEQUAL)
    assert (surface.size, surface.is_filled) == (0, sign < 0)
    assert surface.redistance([np.empty(0, np.float32)]).fields[0].size == 0
    assert volume(surface) == pytest.approx(0 if sign > 0 else 210 * 2.1)
    assert surface.distance_from(surface.snapshot()) == (surface.half_width, 1)
    assert check_level_set(surface) == []


# ------------------------------------------------------------------------------------------------------- topology


def test_two_growing_balls_merge():
    """Exact: min(d1, d2) - t, in front of the crease where they meet."""
    shape = (34, 34, 50)
    apart = [ball(shape, ISOTROPIC, 8.0, (0.3, 0.2, s * 10.2)) for s in (1, -1)]
    exact = np.minimum(*apart)
    surface = LevelSet(exact, ISOTROPIC)
    assert objects(surface) == 2
    steps(surface, constant(-1.0), 0.4, 4)
    assert objects(surface) == 2
    steps(surface, constant(-1.0), 0.4, 8)
    assert objects(surface) == 1
    want = exact - 4.8
    off_crease = np.abs(apart[0] - apart[1]) > 3
    error = np.abs(surface.psi - want)[(np.abs(want) < 1) & off_crease]
    print(f"merged: mean error {error.mean():.1e}, max {error.max():.1e} voxel")
    assert error.max() < 0.1
    assert np.abs(surface.psi - want)[np.abs(want) < 1].mean() < 0.03


def test_a_dumbbell_splits():
    """Two overlapping balls shrink. Exact: all that is further than t from the outside, so from the ring too."""
    shape, radius, half = (34, 34, 50), 10.0, 8.0
    z, y, x = coordinates(shape, ISOTROPIC)
    apart = [np.sqrt(z**2 + y**2 + (x - s * half) ** 2) - radius for s in (1, -1)]
    ring = np.sqrt(radius**2 - half**2)
    to_ring = -np.hypot(np.hypot(z, y) - ring, x)
    # In the cone of the neck the ring is the closest point, elsewhere the nearer ball.
    outside_neck = np.hypot(z, y) * half > ring * (half - np.abs(x))
    exact = np.where(outside_neck | (np.minimum(*apart) > 0), np.minimum(*apart), to_ring)
    surface = LevelSet(exact, ISOTROPIC)
    assert objects(surface) == 1
    steps(surface, constant(1.0), 0.4, 11)
    assert objects(surface) == 1
    steps(surface, constant(1.0), 0.4, 6)
    assert objects(surface) == 2
    want = exact + 6.8
    error = np.abs(surface.psi - want)[np.abs(want) < 0.7]
    print(f"split: mean error {error.mean():.1e}, max {error.max():.1e} voxel")
    assert error.mean() < 0.12
    assert error.max() < 0.5
    assert volume(surface) == pytest.approx((want < 0).sum(), rel=0.1)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("where", [(6.2, 6.1, 6.3), (0.0, 6.0, 6.0), (0.2, 20.8, 0.1)])
def test_small_components_vanish_and_large_ones_stay(where, sign):
    """Inside and outside, in the volume, on its face, in its corner; one object of radius 1.2 and one of 3."""
    shape = (22, 22, 34)

    def at(centre, radius):
        z, y, x = reference.coordinates(shape, ISOTROPIC, centre)
        return np.sqrt(z**2 + y**2 + x**2) - radius

    large, middle = at((11.3, 11.2, 24.1), 7.0), at((14.1, 14.2, 8.2), 3.0)
    psi = sign * np.minimum(np.minimum(large, middle), at(where, 1.2))
    surface = LevelSet(psi, ISOTROPIC)
    number = ndimage.label(psi < 0 if sign > 0 else psi > 0)[1]
    assert number == 3
    assert surface.remove_small() == 1
    # What psi keeps of the flipped cells may hold a few cells in the band for one more redistance.
    redistanced(surface, 2)
    want = redistanced(LevelSet(sign * np.minimum(large, middle), ISOTROPIC), 2)
    assert surface.remove_small() == 0
    assert check_level_set(surface) == []
    np.testing.assert_array_equal(surface.labels, want.labels)
    odd = np.argwhere(in_band(surface) != in_band(want))
    if min(where) > 0.1 and max(where) < 20:
        assert len(odd) == 0
    else:
        # In a corner the zero level that is left beyond the border holds a few cells for a while.
        assert (np.abs(odd - where) < 6).all()
    assert volume(surface) == pytest.approx(volume(want), rel=2e-3)
    near = np.abs(want.psi) < 1
    np.testing.assert_allclose(surface.psi[near], want.psi[near], atol=0.02)


# ------------------------------------------------------------------------------------------- volume, area, curvature


def test_volume_and_area_converge_to_the_exact_ones():
    """Relative errors of ball and torus over 24..64."""
    for name, want_volume, want_area in (
        ("ball", 4 / 3 * np.pi * 0.6**3, 4 * np.pi * 0.6**2),
        ("torus", 2 * np.pi**2 * 0.55 * 0.3**2, 4 * np.pi**2 * 0.55 * 0.3),
    ):
        surfaces = [LevelSet(*((e := exact_case(name, n))[0], (e[1],) * 3)) for n in SIZES]
        in_volume = [abs(volume(s) / want_volume - 1) for s in surfaces]
        in_area = [abs(area(s) / want_area - 1) for s in surfaces]
        print(f"{name}: volume", *(f"{e:.1e}" for e in in_volume), f"order {order(in_volume):.2f}")
        print(f"{name}: area", *(f"{e:.1e}" for e in in_area), f"order {order(in_area):.2f}")
        assert in_volume[-1] < 2e-3
        assert in_area[-1] < 2e-3
        assert order(in_volume) > 1.5


@pytest.mark.parametrize("spacing", [ISOTROPIC, (1.5, 1.0, 0.8)])
def test_volume_and_area_of_a_cube(spacing):
    """Edges are rounded by less than a voxel: about 2 % of the area at 24 voxels a side, 1 % at twice as many."""
    missing = []
    for fine in (1.0, 0.5):
        h = tuple(v * fine for v in spacing)
        z, y, x = coordinates(tuple(round(36 / v) for v in h), h)
        surface = LevelSet(np.maximum(np.maximum(abs(z), abs(y)), abs(x)) - 12.2, h)
        assert volume(surface) == pytest.approx(24.4**3, rel=5e-3)
        missing.append(1 - area(surface) / (6 * 24.4**2))
    print("cube: area missing", *(f"{m:.3f}" for m in missing))
    assert 0 < missing[1] < 0.8 * missing[0]
    assert missing[0] < 0.035


@pytest.mark.parametrize(("radius", "most"), [(2.0, 0.02), (5.0, 0.003), (10.0, 0.0005)])
def test_volume_of_small_balls_anywhere_on_the_grid(radius, most):
    """Shares by the plane through psi at the centre alone are 0.25 (h/R)^2 too large: 6.6 % at R = 2, 1 % at 5."""
    rng = np.random.default_rng(7)
    n = int(2 * radius) + 9
    for _ in range(4):
        offset = rng.uniform(-0.5, 0.5, 3)
        surface = LevelSet(ball((n, n, n), ISOTROPIC, radius, tuple(offset)), ISOTROPIC)
        volume = surface.volume(surface.fraction_and_area()[0])
        assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=most)
    h = (2.0, 1.0, 1.0)
    surface = LevelSet(ball((n // 2 + 5, n, n), h, radius, tuple(offset)), h)
    volume = surface.volume(surface.fraction_and_area()[0])
    # The error is of fourth order in the largest spacing; a radius of 2 is one voxel along z.
    assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=8 * most if radius > 2 else 0.03)


def test_volume_follows_the_band_as_it_moves():
    """The count of inside voxels beyond the band is kept, not counted again."""
    surface = LevelSet(reference.smooth_noise((20, 24, 22), 8, 3.0), (1.5, 1.0, 0.8))
    for value in (0.9, -0.9, -0.9, -0.9):
        steps(surface, constant(value), 0.4, 3, checks=6)
        part, _ = surface.fraction_and_area()
        beyond = np.count_nonzero((surface.psi < 0) & ~in_band(surface))
        assert surface.volume(part) == pytest.approx((beyond + part.sum()) * 1.2, rel=1e-12)


def test_change_names_the_inside_cells_that_entered_and_left():
    surface = LevelSet(ball((24, 24, 24), ISOTROPIC, 8.0), ISOTROPIC)
    for value in (0.8, -0.8):
        before = in_band(surface).ravel()
        surface.advance(np.full(surface.size, value, np.float32), 0.6)
        inside = surface.psi.ravel() < 0
        change = surface.redistance()
        after = in_band(surface).ravel()
        np.testing.assert_array_equal(
            np.sort(change.entered_inside), np.flatnonzero(after & ~before & inside)
        )
        np.testing.assert_array_equal(
            np.sort(change.left_inside), np.flatnonzero(before & ~after & inside)
        )
        assert change.entered_inside.size + change.left_inside.size > 0


def test_curvature_at_the_surface_converges():
    errors = []
    for n in SIZES:
        exact, h = exact_case("torus", n)
        surface = LevelSet(exact, (h, h, h))
        front = surface.front()
        got = surface.curvature(front)[front]
        z, y, x = coordinates(exact.shape, (h, h, h), (0.3 * h, -0.2 * h, 0.1 * h))
        z, y, x = (c.ravel()[surface.band.cells[front]] for c in (z, y, x))
        rho = np.hypot(y, x)
        cosine = (rho - 0.55) / np.hypot(rho - 0.55, z)
        want = 1 / 0.3 + cosine / (0.55 + 0.3 * cosine)
        errors.append(np.sqrt(np.mean((got - want) ** 2)))
    print(
        "torus: rms error of the curvature",
        *(f"{e:.1e}" for e in errors),
        f"order {order(errors):.2f}",
    )
    assert order(errors) >= 1.8
    assert errors[-1] < 0.05


# -------------------------------------------------------------------------------------------------- one slice, thin


def test_one_slice_is_the_curve_of_the_paper():
    spacing, radius = (2.5, 1.0, 0.8), 11.0
    shape = (1, 40, 46)
    z, y, x = coordinates(shape, spacing, (0, 0.2, -0.1))
    exact = np.hypot(y, x) - radius
    surface = redistanced(LevelSet(exact, spacing), 20)
    assert np.abs(surface.psi - exact)[np.abs(exact) < 1].max() < 0.01
    assert volume(surface) == pytest.approx(np.pi * radius**2 * 2.5, rel=2e-3)
    assert area(surface) == pytest.approx(2 * np.pi * radius * 2.5, rel=2e-3)
    front = surface.front()
    assert surface.curvature(front)[front].mean() == pytest.approx(1 / radius, rel=5e-3)
    steps(surface, constant(1.0), 0.4, 10)
    assert np.abs(surface.psi - exact - 4)[np.abs(exact + 4) < 1].max() < 0.05


class Strict(np.ndarray):
    """An array that raises on negative indices, which Python and compiled code would take from the end."""

    def __getitem__(self, index):
        assert not isinstance(index, (int, np.integer)) or index >= 0, f"index {index}"
        return super().__getitem__(index)

    def __setitem__(self, index, value):
        assert not isinstance(index, (int, np.integer)) or index >= 0, f"index {index}"
        super().__setitem__(index, value)


def strict_where_possible(surface):
    """Compiled code takes no subclasses: with the JIT off every index is looked at."""
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        surface.dense = DenseArrays(surface.dense.psi.view(Strict), surface.dense.slot.view(Strict))
    return surface


@pytest.mark.sampled
@pytest.mark.nojit
@pytest.mark.parametrize("spacing", [ISOTROPIC, UNEQUAL])
@pytest.mark.parametrize(
    "shape", [(7, 9, 8), (1, 9, 12), (2, 9, 8), (3, 8, 10), (9, 1, 8), (9, 8, 2), (1, 1, 9)]
)
def test_surfaces_that_cross_every_border_of_small_volumes(shape, spacing):
    """All that a step does, on rough surfaces: indices inside, values finite, band in order."""
    surface = strict_where_possible(LevelSet(reference.smooth_noise(shape, 9, 1.2), spacing))
    field = np.linspace(-1, 1, surface.size, dtype=np.float32)
    for _ in range(3):
        front = surface.front()
        assert np.isfinite(surface.curvature(front)).all()
        part, cut = surface.fraction_and_area()
        assert ((part >= 0) & (part <= 1) & (cut >= 0)).all()
        surface.extend_outwards(field, front)
        assert np.isfinite(field).all()
        surface.advance(field, 0.2)
        surface.remove_small()
        (field,) = surface.redistance([field]).fields
        assert check_level_set(surface, last=5) == []
        if surface.size == 0:
            break


@pytest.mark.nojit
def test_a_small_ball_in_plain_python():
    """The whole of a level set, small enough for the JIT to be off: exact distance, step, small component."""
    exact = ball((11, 12, 13), (1.2, 1.0, 0.9), 3.6)
    surface = strict_where_possible(LevelSet(exact, (1.2, 1.0, 0.9), 2.5))
    assert np.abs(surface.psi - exact)[np.abs(exact) < 0.9].max() < 0.05
    surface.advance(np.full(surface.size, 1.0, np.float32), 0.4)
    assert surface.remove_small() == 0
    surface.redistance()
    assert np.abs(surface.psi - exact - 0.4)[np.abs(exact + 0.4) < 0.9].max() < 0.1
    assert check_level_set(surface) == []


# ---------------------------------------------------------------------------------------------------- the contract


def test_inputs_are_not_modified():
    given = ball((14, 15, 16), ISOTROPIC, 5.0).astype(np.float32)
    kept = given.copy()
    surface = LevelSet(given, ISOTROPIC)
    np.testing.assert_array_equal(given, kept)
    speed = np.full(surface.size, 0.5, np.float32)
    front = surface.front()
    snapshot = surface.snapshot()
    held = snapshot.psi.copy(), snapshot.cells.copy()
    surface.curvature(front)
    surface.fraction_and_area()
    surface.advance(speed, 0.3)
    surface.remove_small()
    surface.redistance([speed])
    np.testing.assert_array_equal(given, kept)
    np.testing.assert_array_equal(snapshot.psi, held[0])
    np.testing.assert_array_equal(snapshot.cells, held[1])
    assert (speed == 0.5).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_an_array_that_may_be_overwritten_gives_the_same_surface(dtype):
    """Its memory is used where that is possible; otherwise, and when not asked for, it is untouched."""
    given = reference.smooth_noise((14, 15, 16), 4, 2.0).astype(dtype)
    kept = given.copy()
    surfaces = [LevelSet(given, UNEQUAL)]
    np.testing.assert_array_equal(given, kept)
    assert not np.shares_memory(given, surfaces[0].dense.psi)
    surfaces.append(LevelSet(given, UNEQUAL, overwrite=True))
    assert np.shares_memory(given, surfaces[1].dense.psi) == (dtype is np.float32)
    if dtype is not np.float32:
        np.testing.assert_array_equal(given, kept)
    for surface in surfaces:
        surface.advance(np.full(surface.size, 0.3, np.float32), 0.5)
        surface.redistance()
    one, other = surfaces
    assert one.psi.tobytes() == other.psi.tobytes()
    assert one.band.cells.tobytes() == other.band.cells.tobytes()
    assert one.volume(one.fraction_and_area()[0]) == other.volume(other.fraction_and_area()[0])


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int16])
@pytest.mark.parametrize("layout", ["C", "F"])
def test_any_type_and_layout_of_psi(dtype, layout):
    psi = np.where(ball((9, 10, 11), ISOTROPIC, 3.0) < 0, -1, 1)
    want = LevelSet(psi.astype(np.float32), ISOTROPIC)
    got = LevelSet(np.array(psi, dtype=dtype, order=layout), ISOTROPIC)
    np.testing.assert_array_equal(got.psi, want.psi)


def test_psi_is_read_only_and_labels_are_its_sign():
    surface = LevelSet(ball((14, 15, 16), ISOTROPIC, 5.0), ISOTROPIC)
    with pytest.raises(ValueError, match="read-only"):
        surface.psi[0, 0, 0] = 1
    assert surface.labels.dtype == np.uint8
    np.testing.assert_array_equal(surface.labels, surface.psi < 0)


@pytest.mark.parametrize("half_width", [2.0, 3.0, 4.0])
def test_the_band_is_valid_and_as_wide_as_asked(half_width):
    for spacing in (ISOTROPIC, (1.4, 1.0, 0.9)):
        exact = ball((30, 34, 36), spacing, 10.0)
        surface = redistanced(LevelSet(exact, spacing, half_width), 2)
        assert check_level_set(surface) == []
        # Wider where the spacings differ.
        assert (
            surface.half_width == half_width
            if spacing == ISOTROPIC
            else half_width < surface.half_width < 5
        )
        assert surface.gamma == np.float32(surface.half_width * max(spacing))
        assert set(np.abs(surface.psi[~in_band(surface)])) == {surface.gamma}
        assert in_band(surface)[np.abs(exact) < (half_width - 0.1) * min(spacing)].all()
        assert not in_band(surface)[np.abs(exact) > (surface.half_width + 0.1) * max(spacing)].any()
        assert (np.diff(surface.band.cells) > 0).all()


def spoilt(how):
    """A good surface, spoilt in one way."""
    surface = LevelSet(ball((18, 19, 20), (1.2, 1.0, 1.0), 6.0), (1.2, 1.0, 1.0))
    band, dense, some = surface.band, surface.dense, surface.size // 2
    match how:
        case "finite":
            band.to_closest[some] = np.inf
        case "ordered":
            band.cells[some : some + 2] = band.cells[[some + 1, some]]
        case "distances":
            band.to_closest[some] *= 1.5
        case "slots":
            dense.slot[band.cells[some]] = 0
        case "outside":
            dense.psi[0] = 1.0
        case "closed":
            dense.psi[np.flatnonzero((dense.slot < 0) & (dense.psi > 0))[40]] *= -1
        case "slope":
            for array in (band.psi, band.to_closest, dense.psi):
                array *= np.float32(0.5)
            surface.gamma *= np.float32(0.5)
        case "residuals":
            band.to_closest[:] *= -1
    return surface


@pytest.mark.parametrize(
    "how", ["finite", "ordered", "distances", "slots", "outside", "closed", "slope", "residuals"]
)
def test_a_spoilt_level_set_is_found_out(how):
    (finding,) = check_level_set(spoilt(how))
    assert finding.split()[1] == f"{how}:"


def test_a_good_level_set_has_no_findings():
    assert check_level_set(spoilt("in no way")) == []


def test_no_surface_without_a_voxel_on_the_other_side_between_thick_slices():
    """Psi dips between two slices, but no voxel is inside: the interpolant's zero level there is no surface.

    It was taken for one: its distance stayed beside it, the force moved it, and it came out far from the object.
    """
    shape, spacing = (9, 40, 40), (7.5, 0.5, 0.5)
    surface = LevelSet(ball(shape, spacing, 9.0, (0.0, 0.0, 0.0)), spacing)
    _, y, x = coordinates(shape, spacing, (0.0, 0.0, 0.0))
    dip = 0.4 + 0.15 * np.hypot(y, x)
    # In the second and third slice, beside the ball's end in the fourth.
    cells = surface.band.cells
    sides = np.unravel_index(cells, shape)[0]
    on = (sides == 1) | (sides == 2)
    lower = np.broadcast_to(dip, shape).ravel()[cells]
    surface.dense.psi[cells[on]] = np.minimum(surface.dense.psi[cells[on]], lower[on])
    surface.redistance()
    assert check_level_set(surface, 6) == []
    # The ball's end lies between the third and the fourth slice: more than a slice from the second.
    assert surface.psi[1].min() > spacing[0]


def test_no_surface_beyond_the_border_along_thick_slices():
    """Psi of outside voxels of the first slice falls towards the border: continued, it has a zero level 2 mm beyond."""
    shape, spacing = (9, 40, 40), (7.5, 0.5, 0.5)
    surface = LevelSet(ball(shape, spacing, 9.0, (0.0, 0.0, 0.0)), spacing)
    want = surface.psi.copy()
    cells = surface.band.cells
    slices = np.unravel_index(cells, shape)[0]
    # As beside a plane 2 mm beyond the border.
    surface.dense.psi[cells[slices == 0]] = 2.0
    surface.dense.psi[cells[slices == 1]] = 2.0 + spacing[0]
    surface.redistance()
    assert check_level_set(surface, 6) == []
    assert surface.psi[0].min() > 0.9 * want[0].min()


@pytest.mark.parametrize("shape", [(9, 12, 14), (1, 15, 17)])
def test_rows_are_the_front_and_the_cells_beside_it(shape):
    """Neighbours by rows are those by slots, the cell itself where there is none; walls at the border."""
    surface = LevelSet(ball(shape, UNEQUAL, 5.5), UNEQUAL)
    front = surface.front(1.1)
    rows = surface.front_rows(front)
    m, slots = rows.on.size, np.concatenate([rows.on, rows.off])
    np.testing.assert_array_equal(rows.on, np.flatnonzero(front))
    on_grid = np.zeros(shape, bool)
    on_grid.ravel()[surface.band.cells[front]] = True
    beside = ndimage.binary_dilation(on_grid, ndimage.generate_binary_structure(3, 1)).ravel()[
        surface.band.cells
    ]
    np.testing.assert_array_equal(rows.off, np.flatnonzero(beside & ~front))
    assert 0 < rows.off.size < surface.size - m
    index = np.stack(np.unravel_index(surface.band.cells[slots], shape), axis=1)
    for row in range(m):
        for side in range(6):
            other = index[row].copy()
            other[side // 2] += 2 * (side % 2) - 1
            inside = ((other >= 0) & (other < shape)).all()
            slot = surface.dense.slot[np.ravel_multi_index(other, shape)] if inside else -1
            assert slots[rows.neighbours[row, side]] == (slot if slot >= 0 else rows.on[row])
    assert (rows.read < m).all()
    for axis in range(3):
        at = index[:m, axis]
        want = ((at == 0) | (at == shape[axis] - 1)) & (shape[axis] > 1)
        np.testing.assert_array_equal(rows.walls & (1 << axis) != 0, want)
    # Of a constant the extension is that constant, wherever any of the front is read.
    values = np.full(slots.size, np.float32(2.5))
    values[m:] = np.nan
    rows.extend(surface.workers, values)
    read = rows.shares.any(axis=1)
    np.testing.assert_allclose(values[m:][read], 2.5, rtol=1e-6)
    assert read.mean() > 0.9
