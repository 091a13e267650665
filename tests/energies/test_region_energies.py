"""Local regions, likelihoods and thresholds: forces are derivatives of values; updated sums against slow references."""

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.energies import (
    Area,
    Balloon,
    ChanVese,
    Gaussian,
    GaussianLikelihood,
    Geodesic,
    HistogramLikelihood,
    LocalRegion,
    Parzen,
    Threshold,
    WeightedSum,
    chan_vese,
    gaussian_of,
)
from accelsurf.energies.likelihood import BINS
from accelsurf.energies.threshold import threshold_field
from accelsurf.errors import InputError, UsageError
from accelsurf.levelset import LevelSet
from accelsurf.measure.metrics import dice
from tests.support import reference
from tests.support.gradient_check import (
    GRIDS,
    assert_derivative,
    coordinates,
    derivative_and_work,
    smooth_field,
    value,
    value_after_steps,
)

#: Perturbation of the surface, mm.
STEP = 0.3


def image(grid):
    """A soft ball with a drift of brightness across it, between about -1 and 2."""
    z, y, x = coordinates(grid)
    return (
        np.tanh((9.0 - np.sqrt(1.2 * z**2 + y**2 + 0.8 * x**2)) / 3)
        + 0.3 * smooth_field(grid, 1)
        + 0.02 * x
    )


SAMPLES = tuple(
    np.random.default_rng(seed).normal(mean, 0.5, 4000) for seed, mean in ((1, 0.7), (2, -0.8))
)
PARZEN = Parzen(-1.2, 2.1)
COUNTS = tuple(PARZEN.histogram(values) for values in SAMPLES)
ENERGIES = {
    "local": lambda grid: LocalRegion(image(grid), 6.0),
    "local, smeared, area": lambda grid: LocalRegion(image(grid), 4.0, alpha=0.5, epsilon=1.5),
    "gauss": lambda grid: GaussianLikelihood(image(grid)),
    "gauss, smeared, area": lambda grid: GaussianLikelihood(image(grid), alpha=0.7, epsilon=1.5),
    "gauss, fixed": lambda grid: GaussianLikelihood(
        image(grid), models=(Gaussian(0.7, 0.2), Gaussian(-0.8, 0.4))
    ),
    "histogram": lambda grid: HistogramLikelihood(image(grid)),
    "histogram, smeared, area": lambda grid: HistogramLikelihood(
        image(grid), alpha=0.7, epsilon=1.5
    ),
    "histogram, fixed": lambda grid: HistogramLikelihood(
        image(grid), learned=COUNTS, parzen=PARZEN
    ),
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


class Wrong(WeightedSum):
    """Any energy with the sign of its force turned."""

    def force(self, surface, front, curvature):
        return -super().force(surface, front, curvature)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("name", ENERGIES)
def test_the_force_is_the_derivative_of_the_discrete_energy(name, grid, seed):
    # Histograms of few voxels are rough, and so is the field of their logarithms; so are windows of few nodes.
    rough = "histogram" in name or name == "local"
    assert_derivative(ENERGIES[name](grid), grid, seed, STEP, tolerance=0.03 if rough else 0.02)


@pytest.mark.parametrize("name", ENERGIES)
def test_the_wrong_sign_is_no_derivative(name):
    measured, work = derivative_and_work(Wrong([(1.0, ENERGIES[name]("3D"))]), "3D", 2, STEP)
    assert abs(measured - work.sum()) > 0.4 * np.abs(work).sum()


@pytest.mark.parametrize("radius", [1.0, 2.6, 4.0, 7.0])
def test_local_energy_is_the_sum_over_all_windows(radius):
    """Against the reference that sums every window by its formula, with voxels cut by the surface in part."""
    shape, spacing = (13, 17, 15), (1.3, 1.0, 0.9)
    values = np.random.default_rng(1).normal(size=shape)
    z, y, x = np.meshgrid(
        *(np.arange(n) * h for n, h in zip(shape, spacing, strict=True)), indexing="ij"
    )
    psi = np.sqrt((z - 7) ** 2 + (y - 5) ** 2 + (x - 6) ** 2) - 6.0  # runs out of the volume
    surface, energy = LevelSet(psi, spacing), LocalRegion(values, radius)
    energy.start(surface)
    fraction, area = surface.fraction_and_area()
    share = (surface.psi < 0).astype(float)
    share.reshape(-1)[surface.band.cells] = fraction
    layouts = [chan_vese.node_layout(n, radius / h) for n, h in zip(shape, spacing, strict=True)]
    weights = [
        reference.node_weights(n, distance, before, half_width, count)
        for n, (count, distance, before, half_width) in zip(shape, layouts, strict=True)
    ]
    for axis in weights:
        np.testing.assert_allclose(axis.sum(axis=0), 1.0)
    want = reference.local_energy(values.astype(np.float32), share, weights) * np.prod(spacing)
    assert energy.value(surface, fraction, area) == pytest.approx(want, rel=1e-5)


@pytest.mark.parametrize("radius", [5.0, 9.0, 20.0])
def test_the_window_has_the_variance_of_the_ball(radius):
    """Along an axis, R^2/5, however the nodes lie."""
    count, distance, before, half_width = chan_vese.node_layout(201, radius)
    window = reference.node_weights(201, distance, before, half_width, count)[
        round(before + 100 / distance)
    ]
    away = np.arange(201) - np.average(np.arange(201), weights=window)
    assert np.average(away**2, weights=window) == pytest.approx(radius**2 / 5, rel=0.03)


@pytest.mark.sampled
@pytest.mark.parametrize("radius", [1.0, 2.6, 9.0, 50.0])
@pytest.mark.parametrize("n", [2, 9, 200])
def test_nodes_lie_alike_on_both_sides_of_the_middle(n, radius):
    count, distance, before, half_width = chan_vese.node_layout(n, radius)
    weights = reference.node_weights(n, distance, before, half_width, count)
    np.testing.assert_allclose(weights[::-1, ::-1], weights, atol=1e-12)


@pytest.mark.parametrize("name", ["local", "gauss", "histogram", "histogram, fixed"])
def test_updated_sums_equal_those_summed_afresh(name):
    grid = "3D"
    energy = ENERGIES[name](grid)
    z, y, x = coordinates(grid)
    surface = LevelSet(np.sqrt(z**2 + y**2 + (x - 3) ** 2) - 6, GRIDS[grid][1])
    before = (surface.psi < 0).sum()
    updated, afresh = value_after_steps(energy, surface)
    assert (surface.psi < 0).sum() > 1.3 * before  # it did move
    assert updated == pytest.approx(afresh, rel=1e-9)


@pytest.mark.slow
def test_a_local_region_finds_what_one_pair_of_means_cannot():
    """A ball in a brightness that drifts by more than its contrast."""
    z, y, x = np.indices((40, 40, 40)) - 19.5
    truth = z**2 + y**2 + x**2 < 11**2
    scan = (truth + 0.08 * x).astype(np.float32) + np.random.default_rng(1).normal(
        0, 0.1, truth.shape
    )
    found = {
        name: dice(
            segment(scan, start="ball:19,20,19,8vox", energy=name, max_steps=300).labels, truth
        )
        for name in ("chan-vese", "local-region:R=5")
    }
    print(f"\n{found}")
    assert found["local-region:R=5"] > 0.95 > 0.8 > found["chan-vese"]


def test_likelihood_tells_regions_of_one_mean_by_their_variance():
    rng = np.random.default_rng(2)
    z, y, x = np.indices((40, 40, 40)) - 19.5
    truth = z**2 + y**2 + x**2 < 12**2
    scan = rng.normal(0, np.where(truth, 0.2, 1.0))
    for model in ("gauss", "histogram"):
        result = segment(
            scan,
            start="ball:19,20,19,7vox",
            energy=f"likelihood:{model}",
            smoothness=1.0,
            max_steps=300,
        )
        print(f"\n{model}: Dice {dice(result.labels, truth):.3f}")
        assert dice(result.labels, truth) > 0.93


@pytest.mark.sampled
@pytest.mark.parametrize("model", ["gauss", "histogram"])
@pytest.mark.parametrize("background", [(), ("box:2,2,2,5,27,57vox", "ball:44,15,15,6vox")])
def test_likelihood_learns_from_foreground_and_background(model, background):
    """The start is in the wrong object; what is learned decides. Values are told in the image's own unit."""
    z, y, x = np.indices((30, 30, 60)).astype(float)
    balls = [(x - c) ** 2 + (y - 15) ** 2 + (z - 15) ** 2 < 9**2 for c in (15, 44)]
    scan = (
        100.0
        + 50.0 * balls[0]
        + 120.0 * balls[1]
        + np.random.default_rng(1).normal(0, 5, balls[0].shape)
    )
    words = dict(
        start="box:3,3,3,56,26,26vox",
        foreground="ball:15,15,15,5vox",
        smoothness=0.3,
        max_steps=300,
    )
    result = segment(scan, energy=f"likelihood:{model}", background=background, **words)
    assert dice(result.labels, balls[0]) > 0.95
    if model == "gauss":
        inside = result.terms[0]["inside"]
        assert inside["mean"] == pytest.approx(150, abs=1) and inside["deviation"] == pytest.approx(
            5, rel=0.4
        )
    with pytest.raises(UsageError, match="update=yes"):
        segment(scan, energy="likelihood:update=yes", **words)


def test_threshold_is_in_the_image_s_unit_and_auto_is_otsu_s():
    z, y, x = np.indices((30, 30, 30)) - 14.5
    r = np.sqrt(z**2 + y**2 + x**2)
    scan = 1000.0 - 50.0 * r
    result = segment(scan, start="ball:14,15,14,4vox", energy="threshold:600,", max_steps=200)
    # 1000 - 50 r = 600 at r = 8.
    assert result.volume_mm3 == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.03)
    assert (result.terms[0]["LO"], result.terms[0]["HI"]) == (pytest.approx(600), None)
    window = segment(scan, start="threshold:600,800", energy="threshold:550,800", max_steps=200)
    assert window.volume_mm3 == pytest.approx(4 / 3 * np.pi * (9**3 - 4**3), rel=0.05)
    two = (r < 9) * 700.0 + np.random.default_rng(1).normal(0, 30, r.shape)
    auto = segment(two, start="ball:14,15,14,4vox", energy="threshold:auto", max_steps=200)
    assert dice(auto.labels, r < 9) > 0.97 and 300 < auto.terms[0]["LO"] < 400
    dark = segment(-two, start="ball:14,15,14,4vox", energy="threshold:,auto", max_steps=200)
    assert dice(dark.labels, r < 9) > 0.97 and dark.terms[0]["LO"] is None
    fraction = segment(scan, start="ball:14,15,14,4vox", energy="threshold:95%", max_steps=200)
    assert fraction.terms[0]["LO"] == pytest.approx(np.percentile(scan, 95), rel=1e-3)
    assert (fraction.labels > 0).mean() == pytest.approx(0.05, abs=0.005)


def test_soft_edges_are_antisymmetric_about_the_thresholds():
    image = np.linspace(-4, 14, 73).reshape(1, 1, -1)
    got = threshold_field(image, 0.0, 10.0, 1.0)
    np.testing.assert_allclose(got, got[..., ::-1], atol=1e-6)
    assert np.abs(got[0, 0, np.isclose(image[0, 0], 0.0)]).max() < 1e-6
    assert got.min() > -1 - 1e-6 and got[0, 0, 36] < -0.999 and got[0, 0, 0] > 0.99
    for low, high in ((None, None), (3.0, 3.0), (4.0, 3.0)):
        with pytest.raises(UsageError, match="threshold"):
            Threshold(image, low, high)


def test_weighted_sum_adds_values_forces_and_alphas():
    grid = "3D"
    parts = [
        Geodesic(1.0 + 0.4 * smooth_field(grid, 3), alpha=0.2),
        Area(),
        ChanVese(image(grid), alpha=0.3),
    ]
    weights = [0.5, 2.0, 1.5]
    total = WeightedSum(list(zip(weights, parts, strict=True)))
    assert total.alpha == pytest.approx(
        sum(w * p.alpha for w, p in zip(weights, parts, strict=True))
    )
    z, y, x = coordinates(grid)
    got, surface, area = value(total, np.sqrt(z**2 + y**2 + x**2) - 12, grid)
    fraction, _ = surface.fraction_and_area()
    front = surface.front()
    curvature = surface.curvature(front)
    assert got == pytest.approx(
        sum(w * p.value(surface, fraction, area) for w, p in zip(weights, parts, strict=True))
    )
    want = sum(w * p.force(surface, front, curvature) for w, p in zip(weights, parts, strict=True))
    np.testing.assert_allclose(
        total.force(surface, front, curvature)[front], want[front], rtol=1e-4, atol=1e-6
    )


def test_nothing_to_learn_from_is_told():
    with pytest.raises(InputError, match="no voxel"):
        HistogramLikelihood(image("3D"), learned=(np.zeros(BINS), np.ones(BINS)))
    with pytest.raises(InputError, match="no voxel"):
        gaussian_of(np.zeros(0), 0.1)


@pytest.mark.threads
def test_any_number_of_threads_gives_the_same_bytes():
    scan = image("3D").astype(np.float32)
    text = "local-region:R=5 + 0.4*likelihood:histogram + 0.2*likelihood + 0.3*threshold:0.2, + 0.1*area"
    words = dict(
        spacing=GRIDS["3D"][1], start="ball:20,21,19,8vox", energy=text, max_steps=40, levels=1
    )
    one, three = (segment(scan, threads=threads, **words) for threads in (1, 3))
    np.testing.assert_array_equal(one.psi, three.psi)
    assert [row.potential for row in one.history] == [row.potential for row in three.history]
