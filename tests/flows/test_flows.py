import numpy as np
import pytest
from scipy.special import sph_harm_y

from accelsurf.flows import ConstantDensity, Gradient, StepInput, StepLimits
from accelsurf.flows.diffusion import (
    SAFETY,
    STAGES,
    diffuse,
    largest_diffusion,
    one_stage_diffusion,
)
from accelsurf.flows.protocol import clip_speed, percentile, voxel_rates
from accelsurf.levelset import LevelSet

R = 12.0


def sphere(n=36, spacing=(1.0, 1.0, 1.0), r=R):
    z, y, x = (np.indices((n, n, n)) - 0.5 * (n - 1)) * np.reshape(spacing, (3, 1, 1, 1))
    return LevelSet(np.sqrt(z**2 + y**2 + x**2) - r, spacing)


def angles(surface):
    n = surface.shape[0]
    z, y, x = (
        np.array(np.unravel_index(surface.band.cells, surface.shape)) - 0.5 * (n - 1)
    ).astype(float)
    return np.arccos(z / np.sqrt(z**2 + y**2 + x**2)), np.arctan2(y, x)


def harmonic(surface, degree):
    polar, azimuth = angles(surface)
    return np.real(sph_harm_y(degree, 1, polar, azimuth)).astype(np.float32)


def moved(flow, surface, force, alpha=0.0, limits=None):
    front = surface.front()
    if not any(field.size for field in flow.fields):
        flow.start(surface)
    curvature = surface.curvature(front)
    area = surface.fraction_and_area()[1]
    full = np.where(front, np.float32(force), np.float32(0.0)).astype(np.float32)
    now = StepInput(surface, front, full, curvature, area, alpha)
    return flow.move(now, limits or StepLimits(percentile=100.0)), front


def decay_rates(surface, field, eigenvalue):
    """Rate of a harmonic over the exact one, for the largest amount of every number of stages."""
    front = surface.front(surface.half_width - 1.0)
    surface.extend_outwards(field, front)
    area = surface.fraction_and_area()[1]
    weight = area * field
    rates = []
    for stages in STAGES:
        after, amount = field.copy(), SAFETY * stages.amount * one_stage_diffusion(surface)
        diffuse(surface, front, after, amount)
        factor = float((weight * after).sum() / (weight * field).sum())
        rates.append(-np.log(factor) / (amount * eigenvalue))
    return np.array(rates)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_diffusion_decays_as_on_the_sphere(degree):
    """Y_l under beta_t = D Lap_S beta decays as exp(-D l(l+1) t/r^2): 0.96 to 1.005 times that at r = 12 voxels."""
    surface = sphere()
    rates = decay_rates(surface, harmonic(surface, degree), degree * (degree + 1) / R**2)
    print(f"\nsphere, l = {degree}: {np.round(rates, 4)}")
    assert np.abs(rates - 1.0).max() < 0.05


@pytest.mark.parametrize("width", [3.0, 4.0])
@pytest.mark.parametrize(("r", "tolerance"), [(12, 0.05), (96, 0.01)])
def test_diffusion_decays_as_on_the_circle(r, tolerance, width):
    """cos(l phi), l = 1 to 4, as exp(-D l^2 t/r^2); at r = 96 voxels within 0.1 %, at 12 the step shows (l = 4)."""
    y, x = np.indices((2 * r + 14, 2 * r + 14)) - (r + 6.5)
    y, x = y - 0.13, x - 0.31
    surface = LevelSet((np.sqrt(y**2 + x**2) - r)[None], (1.0, 1.0, 1.0), width)
    phi = np.arctan2(y, x).ravel()[surface.band.cells]
    for degree in (1, 2, 3, 4):
        rates = decay_rates(surface, np.cos(degree * phi).astype(np.float32), degree**2 / r**2)
        print(f"\ncircle r = {r}, l = {degree}: {np.round(rates, 4)}")
        assert np.abs(rates - 1.0).max() < tolerance


def test_diffusion_polynomials_are_of_second_order_and_damp_fine_waves():
    """p(0) = p'(0) = p''(0) = 1 (one stage: 1 + z), |p| <= 1 as far as the step is stable, and small for the finest."""
    for stages in STAGES:
        basis = np.zeros(stages.stages + 1)
        basis[stages.stages], basis[stages.blended] = stages.blend, 1.0 - stages.blend
        p = np.polynomial.Legendre(basis)
        slope, bend = p.deriv()(1.0) / stages.amount, p.deriv(2)(1.0) / stages.amount**2
        assert p(1.0) == pytest.approx(1.0) and slope == pytest.approx(1.0)
        assert bend == pytest.approx(0.0 if stages.stages == 1 else 1.0)
        x = np.linspace(-1.0, 1.0, 2001)
        assert np.abs(p(x)).max() <= 1.0 + 1e-12
        fine = x[(1.0 - x) * stages.amount > 4.0]
        assert np.abs(p(fine)).max(initial=0.0) < 0.74


def test_diffusion_is_stable_at_its_bound_in_noise():
    """The largest amount that the stages reach: noise shrinks, the mean stays, a constant is left alone."""
    surface = sphere()
    front = surface.front()
    amount = largest_diffusion(surface)
    assert amount == pytest.approx(SAFETY * STAGES[-1].amount * one_stage_diffusion(surface))
    field = np.random.default_rng(0).normal(size=surface.size).astype(np.float32)
    surface.extend_outwards(field, front)
    on = np.flatnonzero(surface.fraction_and_area()[1])
    spread = field[on].std()
    for _ in range(5):
        diffuse(surface, front, field, amount)
        assert field[on].std() < spread
        spread = field[on].std()
    assert spread < 0.1
    constant = np.full(surface.size, 0.7, np.float32)
    diffuse(surface, front, constant, amount)
    np.testing.assert_allclose(constant, 0.7, rtol=1e-5)


def test_the_diffusion_bound_counts_only_axes_with_slices():
    assert one_stage_diffusion(sphere(16, (1.0, 1.0, 2.0), 5.0)) == pytest.approx(
        0.5 / (1 + 1 + 0.25)
    )
    y, x = np.indices((20, 20)) - 9.5
    flat = LevelSet((np.sqrt(y**2 + x**2) - 5)[None], (3.0, 0.5, 0.5))
    assert one_stage_diffusion(flat) == pytest.approx(0.5 / 8)
    assert flat.smallest_spacing == 0.5


def test_no_front_cell_moves_further_than_the_limit():
    surface = sphere(spacing=(1.5, 1.0, 1.0), n=40)
    force = harmonic(surface, 3) ** 3 * 50
    for flow in (Gradient(), ConstantDensity(diffusion=0.0)):
        limits = StepLimits(cfl=0.4, percentile=60.0)
        move, front = moved(flow, surface, force, limits=limits)
        rates = voxel_rates(surface, front, move.speed)[front] * move.dt
        assert rates.max() <= 0.4 * (1 + 1e-5)
        # What was clipped is reported: 40 % of the cells are faster than the percentile.
        assert 0.3 < move.clipped < 0.45
        assert np.isclose(rates, 0.4, rtol=1e-4).mean() == pytest.approx(move.clipped, abs=0.02)
        free, front = moved(
            flow.__class__(), surface, force, limits=limits._replace(percentile=100.0)
        )
        assert free.clipped == 0 and free.dt < move.dt


def test_percentile_is_a_value_at_its_rank():
    values = np.arange(100.0)
    assert [percentile(values, p) for p in (1, 50, 95, 100)] == [1, 50, 95, 99]
    assert percentile(np.empty(0), 95) == 0


def test_rates_are_in_voxels_along_the_normal():
    surface = sphere(n=40, spacing=(3.0, 1.0, 1.0), r=9.0)
    front = surface.front()
    rates = voxel_rates(surface, front, np.full(surface.size, -2.0, np.float32))
    off = np.abs(surface.band.psi) > 0.2  # where the direction to the closest point is well known
    z, y, x = (np.array(np.unravel_index(surface.band.cells, surface.shape)) - 19.5) * np.array(
        [[3.0], [1.0], [1.0]]
    )
    r = np.sqrt(z**2 + y**2 + x**2)
    exact = 2 * np.sqrt((z / r / 3) ** 2 + (y / r) ** 2 + (x / r) ** 2)
    np.testing.assert_allclose(rates[front & off], exact[front & off], rtol=0.01)
    assert not rates[~front].any()


def test_hold_back_scales_only_what_is_too_fast():
    speed, rates = np.array([1.0, -4.0, 2.0], np.float32), np.array([1.0, 4.0, 2.0], np.float32)
    assert clip_speed(speed, rates, 0.25, 0.5) == 1
    np.testing.assert_allclose(speed, [1.0, -2.0, 2.0])


def test_gradient_is_the_force_with_its_two_bounds():
    surface = sphere()
    move, front = moved(Gradient(), surface, 0.25)
    np.testing.assert_allclose(move.speed[front], 0.25)
    # Rate in voxels along the normal; on unit voxels 0.25 per unit time whatever the direction.
    assert move.dt == pytest.approx(0.5 / 0.25, rel=1e-3)
    assert moved(Gradient(), surface, 0.25, limits=StepLimits(dt_max=0.1))[0].dt == 0.1
    # Explicit curvature flow: dt <= h^2/(4 alpha); the rates of both add.
    assert moved(Gradient(), surface, 0.25, alpha=2.0)[0].dt == pytest.approx(
        1 / (8 + 0.5), rel=1e-3
    )
    assert moved(Gradient(), surface, 0.0)[0].dt == 0


def test_gradient_may_be_smoothed_by_the_same_diffusion():
    surface = sphere()
    force = harmonic(surface, 4)
    plain, front = moved(Gradient(), surface, force)
    smooth, _ = moved(Gradient(diffusion=0.5), surface, force)
    on = np.flatnonzero(surface.fraction_and_area()[1])
    factor = float(
        np.dot(smooth.speed[on], plain.speed[on]) / np.dot(plain.speed[on], plain.speed[on])
    )
    assert factor == pytest.approx(np.exp(-0.5 * smooth.dt * 20 / R**2), rel=0.02)


@pytest.mark.parametrize(("k", "friction"), [(2.0, None), (3.0, None), (1.5, None), (2.0, 0.7)])
def test_start_up_series(k, friction):
    """From rest beta(dt/2) = lambda (k/2) (dt/2)^(k-1) f/rho; with friction a (dt/2) lambda f/rho/(1 + a dt/4)."""
    surface = sphere()
    flow = ConstantDensity(k, lambda_=1.3, rho=2.0, friction=friction, diffusion=0.0)
    flow.start(surface)
    move, front = moved(flow, surface, 0.25, limits=StepLimits(dt_max=0.2))
    dt = move.dt
    series = 1.3 * 0.5 * k * (dt / 2) ** (k - 1) * 0.25 / 2.0
    if friction is not None:
        series = 0.5 * dt * 1.3 * 0.25 / 2.0 / (1 + 0.25 * friction * dt)
    np.testing.assert_allclose(move.speed[front], series, rtol=1e-5)
    assert move.energy_rates.kinetic == 0 and flow.clock.time == dt


def test_rest_forgets_the_momentum_and_the_clock():
    surface = sphere()
    flow = ConstantDensity(diffusion=0.0)
    flow.start(surface)
    first, _ = moved(flow, surface, 0.25)
    second, _ = moved(flow, surface, 0.25)
    assert (
        np.abs(second.speed).max() > np.abs(first.speed[surface.front()]).min()
        and flow.clock.time > first.dt
    )
    assert flow.zero_momentum(surface.fraction_and_area()[1]) > 0
    assert flow.clock.time == 0 and flow.clock.at_rest and not flow.beta.any()


def test_wave_bound_with_an_area_weight():
    """dt <= h/(sqrt(3) c_T), c_T = sqrt(w alpha/rho) from rest, w = 4 lambda for k = 2."""
    surface = sphere()
    flow = ConstantDensity(diffusion=0.0, rho=0.5)
    flow.start(surface)
    move, _ = moved(flow, surface, 1e-3, alpha=50.0)
    assert move.dt == pytest.approx(1 / np.sqrt(3 * 4 * 50.0 / 0.5), rel=1e-6)


def test_travel_bound_counts_speed_and_acceleration():
    surface = sphere()
    flow = ConstantDensity(diffusion=0.0)
    flow.start(surface)
    moved(flow, surface, 0.25, limits=StepLimits(dt_max=0.3))
    speed = float(np.abs(flow.beta[surface.front()]).max())
    move, _ = moved(flow, surface, 0.25)
    # b dt + A dt^2/2 = cfl with A = w f/rho
    assert speed * move.dt + 0.5 * 4 * 0.25 * move.dt**2 == pytest.approx(0.5, rel=1e-2)


def test_automatic_diffusion_follows_the_speed():
    surface = sphere()
    rates = []
    for force in (0.25, 0.5):
        flow = ConstantDensity()
        flow.start(surface)
        moved(flow, surface, force, limits=StepLimits(dt_max=0.01))
        rates.append(moved(flow, surface, force, limits=StepLimits(dt_max=0.01))[0].diffusion)
    assert rates[1] == pytest.approx(2 * rates[0], rel=1e-3) and rates[0] > 0


def test_what_the_limiter_takes_is_no_work_of_the_noise():
    """Speeds that are clipped, without noise: counted as smoothing alone, and the rest of the account is as before."""
    surface = sphere(24, r=7.0)
    rng = np.random.default_rng(4)
    flow = ConstantDensity()
    moved(flow, surface, 0.01)
    flow.beta[rng.integers(0, surface.size, 40)] *= np.float32(1000.0)
    plan, _ = moved(flow, surface, 0.01, limits=StepLimits(percentile=50.0))
    assert plan.clipped > 0
    assert plan.energy_rates.noise == 0.0
    assert plan.energy_rates.smoothing > 0.0
