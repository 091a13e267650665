"""Mass and momentum on the grid: sweeps keep what they move, means and forces are adjoint."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.flows.fluid import make_fluid, transport_fluid
from accelsurf.kernels import fluid as kernels
from accelsurf.levelset import LevelSet, Workers

pytestmark = pytest.mark.nojit

SHAPE, SPACING = (5, 7, 6), (2.0, 1.0, 0.5)


def random_fluid(shape: tuple[int, int, int] = SHAPE, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_fluid(
        rng.uniform(0.0, 2.0, shape) * (rng.uniform(size=shape) > 0.3), rng.normal(size=(3, *shape))
    )


def surface_on(shape: tuple[int, int, int] = SHAPE, threads: int = 1) -> LevelSet:
    z, y, x = (np.arange(n) - 0.5 * (n - 1) for n in shape)
    radius = np.sqrt(
        (SPACING[0] * z[:, None, None]) ** 2 + (y[:, None]) ** 2 + (SPACING[2] * x) ** 2
    )
    return LevelSet(radius - 1.6, SPACING, 4.0, Workers(threads))


@pytest.mark.parametrize("stiffness", [0.0, 0.7])
@pytest.mark.parametrize("shape", [SHAPE, (1, 7, 6)])
def test_what_a_transport_moves_is_there_or_has_left(
    shape: tuple[int, int, int], stiffness: float
) -> None:
    fluid = random_fluid(shape)
    before = fluid.copy()
    moved = transport_fluid(surface_on(shape), fluid, 0.8, stiffness, 1e-6)
    assert (fluid == before).all() and moved.steps > 1
    assert abs(moved.left) > 0.01 and moved.fluid[0].min() >= 0.0
    assert moved.fluid[0].sum() + moved.left == pytest.approx(before[0].sum(), rel=1e-5)


def test_momentum_is_kept_where_nothing_reaches_the_border() -> None:
    shape = (5, 13, 12)
    fluid = np.zeros((4, *shape), np.float32)
    fluid[:, 2, 5:8, 5:8] = random_fluid((1, 3, 3))[:, 0]
    moved = transport_fluid(surface_on(shape), fluid, 0.1, 0.5, 1e-6)
    assert abs(moved.left) < 1e-6
    np.testing.assert_allclose(
        moved.fluid.sum(axis=(1, 2, 3)), fluid.sum(axis=(1, 2, 3)), rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_mirrored_fluid_moves_as_the_mirror_image(axis: int) -> None:
    surface, fluid = surface_on(), random_fluid()
    mirrored = np.flip(fluid, 1 + axis).copy()
    mirrored[1 + axis] *= -1
    one, other = (
        transport_fluid(surface, state, 0.3, 0.4, 1e-6).fluid for state in (fluid, mirrored)
    )
    other[1 + axis] *= -1
    np.testing.assert_allclose(np.flip(other, 1 + axis), one, atol=2e-6)


def test_an_even_wind_carries_a_bump_downstream() -> None:
    """By a voxel and a half along x, which has the finest spacing; the other sign would carry it away from there."""
    shape = (1, 5, 40)
    x = np.arange(40.0)
    density = np.broadcast_to(1.0 + np.exp(-0.5 * ((x - 15.0) / 4.0) ** 2), shape)
    velocity = np.zeros((3, *shape))
    velocity[2] = 1.0
    moved = transport_fluid(
        surface_on(shape), make_fluid(density, velocity), 0.75, 0.0, 1e-6
    ).fluid[0, 0, 2]
    there = 1.0 + np.exp(-0.5 * ((x - 16.5) / 4.0) ** 2)
    assert np.abs(moved - there)[5:-5].max() < 0.01


@pytest.mark.threads
def test_any_number_of_threads_gives_the_same_bytes() -> None:
    shape = (23, 9, 8)
    one, more = (
        transport_fluid(surface_on(shape, n), random_fluid(shape), 0.5, 0.6, 1e-6) for n in (1, 3)
    )
    assert one.fluid.tobytes() == more.fluid.tobytes() and one.left == more.left


def test_equal_states_have_their_own_flux_and_none_is_none() -> None:
    out, state = np.empty(4), np.array((1.5, 0.3, -0.2, 0.1))
    kernels.hll_flux(state, state, 0.8, out)
    momentum = 1.5 * 0.3
    np.testing.assert_allclose(
        out, (momentum, momentum * 0.3 + 0.4 * 1.5**2, momentum * -0.2, momentum * 0.1)
    )
    kernels.hll_flux(np.zeros(4), np.zeros(4), 0.8, out)
    assert (out == 0.0).all()
    apart = np.array((1.0, -1.0, 0.0, 0.0)), np.array((1.0, 1.0, 0.0, 0.0))
    kernels.hll_flux(*apart, 0.0, out)
    assert (out == 0.0).all()


def test_what_is_spread_across_works_what_the_means_say() -> None:
    """sum over cells of rho V . (spread of a) = sum over the surface of <rho> <V> . a."""
    surface, fluid = surface_on(), random_fluid()
    rng = np.random.default_rng(1)
    normal, where = surface.normals(), surface.front(1.5)
    layer = where, normal, 1.0, np.zeros((surface.size, 3))
    means, values = np.empty((surface.size, 4)), rng.normal(size=(surface.size, 3))
    surface.workers.parallel(
        kernels.means_across, surface.size, fluid, surface.grid, surface.band, layer, means
    )
    spread = np.zeros((surface.size, 3))
    there = surface.dense.slot, surface.grid, surface.band
    surface.workers.serial(kernels.extend_across, 0, surface.size, *there, layer, values, spread)
    momentum = fluid.reshape(4, -1)[1:, surface.band.cells].T
    one = float((momentum * spread).sum())
    other = float((means[:, :1] * means[:, 1:] * values)[where].sum())
    # All cells around the samples are in the band, as the grid is small.
    assert surface.size == np.prod(SHAPE) and abs(one) > 0.1
    assert one == pytest.approx(other, rel=1e-5)


def test_a_mean_of_an_even_fluid_is_the_fluid() -> None:
    surface = surface_on()
    fluid = make_fluid(np.full(SHAPE, 1.3), np.stack([np.full(SHAPE, v) for v in (0.1, -0.2, 0.3)]))
    layer = np.ones(surface.size, np.bool_), surface.normals(), 1.5, np.zeros((surface.size, 3))
    means = np.empty((surface.size, 4))
    surface.workers.parallel(
        kernels.means_across, surface.size, fluid, surface.grid, surface.band, layer, means
    )
    np.testing.assert_allclose(
        means, np.broadcast_to((1.3, 0.1, -0.2, 0.3), means.shape), rtol=1e-5
    )


def test_a_push_is_limited_in_voxels() -> None:
    surface, fluid = surface_on(), random_fluid()
    impulse = np.zeros((surface.size, 3))
    impulse[::2] = (0.5, 4.0, -3.0)
    out = fluid.copy()
    kernels.accelerate_layer(0, surface.size, out, surface.grid, surface.band.cells, impulse, 2.0)
    rho = fluid.reshape(4, -1)[0, surface.band.cells].astype(float)
    velocity = np.divide(
        out.reshape(4, -1)[1:, surface.band.cells], rho, out=np.zeros((3, rho.size)), where=rho > 0
    )
    rates = np.linalg.norm(velocity.T / SPACING, axis=1)
    assert rates[::2][rho[::2] > 0] == pytest.approx(2.0, rel=1e-4)
    assert (
        out.reshape(4, -1)[:, surface.band.cells[1::2]]
        == fluid.reshape(4, -1)[:, surface.band.cells[1::2]]
    ).all()
