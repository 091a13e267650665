"""The geodesic energy: its force is the derivative of its value, on exact fields and through a whole segmentation."""

import json

import numpy as np
import pytest
from scipy import special

from accelsurf import cli, io
from accelsurf.api.segment import segment
from accelsurf.energies import Geodesic, edge_contrast, edge_indicator
from accelsurf.errors import InputError
from accelsurf.image.smoothing import gradient_magnitude
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.run.energy import make_energy
from accelsurf.settings.run_config import RunConfig
from tests.support.gradient_check import (
    GRIDS,
    assert_derivative,
    coordinates,
    derivative_and_work,
    smooth_field,
    value,
)

#: Perturbations (mm) of most of a voxel: the area is summed over voxels that the surface cuts each by a plane of its
#: own, which makes it vary by a thousandth as the surface crosses the grid; smaller perturbations would measure that.
STEP = 0.6


def price(grid):
    """A phi between 0.3 and 1.7 that varies over a few voxels, so that its slope weighs as much as the curvature."""
    return 1.0 + 0.7 * smooth_field(grid, 1, 3.0)


class WrongAdvection(Geodesic):
    """f = phi H - grad phi . n: the sign that the equation has for an inward normal."""

    def force(self, surface, front, curvature):
        without_slope = Geodesic.force(self, surface, front, np.zeros_like(curvature))
        return super().force(surface, front, curvature) - 2.0 * without_slope


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize(
    "options",
    [{}, {"balloon": -0.5}, {"alpha": 0.8, "balloon": 0.3}],
    ids=["plain", "balloon", "area"],
)
def test_the_force_is_the_derivative_of_the_discrete_energy(grid, options, seed):
    """dU/d(epsilon) under a smooth normal perturbation eta (outward) is +int f eta dA, within 2 %."""
    assert_derivative(Geodesic(price(grid), **options), grid, seed, STEP)


@pytest.mark.parametrize("grid", GRIDS)
def test_the_wrong_sign_of_the_advection_is_no_derivative(grid):
    measured, work = derivative_and_work(WrongAdvection(price(grid)), grid, 2, STEP)
    assert abs(measured - work.sum()) > 0.06 * np.abs(work).sum()


@pytest.mark.parametrize("grid", GRIDS)
def test_force_on_a_sphere_in_a_field_with_a_constant_slope(grid):
    """phi = 1 + 0.02 x.e: f = phi (d-1)/r + 0.02 e.n + c phi, on the whole front."""
    points, radius, slope, balloon = coordinates(grid), 12.3, 0.02, -0.1
    way = np.array([0.48, 0.6, 0.64]) if GRIDS[grid][0][0] > 1 else np.array([0.0, 0.6, 0.8])
    phi = 1.0 + slope * np.tensordot(way, points, axes=1)
    distance = np.sqrt((points**2).sum(axis=0))

    def worst(kind):
        energy = kind(phi, balloon=balloon)
        surface = value(energy, distance - radius, grid)[1]
        front = surface.front()
        at = points.reshape(3, -1)[:, surface.band.cells[front]]
        n = at / np.linalg.norm(at, axis=0)
        true = (1.0 + slope * radius * way @ n) * (bends / radius + balloon) + slope * way @ n
        return np.abs(energy.force(surface, front, surface.curvature(front))[front] - true).max()

    bends = sum(n > 1 for n in GRIDS[grid][0]) - 1
    print(f"\n{grid}: force off by {worst(Geodesic):.5f} of at most {bends / radius:.3f}")
    assert worst(Geodesic) < 0.003
    assert worst(WrongAdvection) > 1.9 * slope * 0.8


def test_value_of_a_ball_in_a_known_field():
    """phi = 1 + b r^2: U = 4 pi r^2 phi(r) + c int phi, alpha adds its area."""
    z, y, x = coordinates("3D")
    radius, bend = 12.3, 0.004
    square = z**2 + y**2 + x**2
    area, price_there = 4 * np.pi * radius**2, 1 + bend * radius**2
    inside = 4 / 3 * np.pi * radius**3 + bend * 4 / 5 * np.pi * radius**5
    for alpha, balloon in ((0.0, 0.0), (0.5, 0.0), (0.5, -0.2)):
        energy = Geodesic(1 + bend * square, alpha, balloon)
        got = value(energy, np.sqrt(square) - radius, "3D")[0]
        assert got == pytest.approx(area * (price_there + alpha) + balloon * inside, rel=0.005)


def test_alpha_bounds_the_factor_of_the_curvature():
    phi = price("3D")
    assert Geodesic(phi, alpha=0.25).alpha == pytest.approx(phi.max() + 0.25)


# -------------------------------------------------------------------------------------------------- the indicator


def test_an_edge_looks_alike_along_every_axis_by_default():
    """A step at the middle of thick slices and one across them: phi as low, as broad in mm."""
    spacing = (3.0, 1.0, 1.0)
    low = []
    for axis, n in ((0, 16), (1, 48)):
        image = np.zeros((16, 48, 48))
        image[tuple(slice(n // 2, None) if a == axis else slice(None) for a in range(3))] = 1.0
        gradient = gradient_magnitude(image, spacing, 3.0)
        low.append(gradient.max())
        np.testing.assert_array_equal(
            edge_indicator(gradient),
            edge_indicator(gradient, edge_contrast(gradient)),
        )
    assert low[0] == pytest.approx(low[1], rel=0.25)


def test_phi_is_half_at_the_contrast():
    z, y, x = np.indices((8, 8, 60)) * 1.0
    phi = edge_indicator(gradient_magnitude(0.01 * x**2 / 2, (1, 1, 1), 1.0), 0.3)
    assert phi[4, 4, 30] == pytest.approx(0.5, abs=0.01)
    assert phi[4, 4, 15] == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.4])
def test_automatic_contrast_tells_the_edge_from_noise(noise):
    image, truth, radius = ball(noise)
    phi = edge_indicator(gradient_magnitude(image, (1, 1, 1), 1.0))
    on, off = np.abs(radius - 12.3) < 0.5, np.abs(radius - 12.3) > 4
    assert np.median(phi[on]) < 0.25 and np.median(phi[off]) > 0.75


def test_an_image_without_edges_is_refused():
    with pytest.raises(InputError, match="no edge"):
        edge_indicator(np.zeros((8, 8, 8), np.float32))


def test_a_tiny_object_has_an_edge():
    """Fewer voxels than the percentile leaves out."""
    image = np.zeros((40, 40, 40))
    image[20, 20, 20] = 1
    assert edge_indicator(gradient_magnitude(image, (1, 1, 1), 1.0)).min() < 0.1


# ---------------------------------------------------------------------------------------------- whole segmentations


def ball(noise, shape=(40, 42, 44), spacing=(1.0, 1.0, 1.0)):
    """A ball of radius 12.3 mm and contrast 1, antialiased, in noise of that sigma: image, truth, distance from it."""
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(shape, spacing, strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    radius = np.sqrt(z**2 + (y - 0.7) ** 2 + (x + 0.4) ** 2)
    image = np.clip(12.8 - radius, 0, 1) + np.random.default_rng(3).normal(0, noise, radius.shape)
    return image, radius < 12.3, radius


STARTS = {
    "around": {"start": "ball:22,20,20,17.5vox"},
    "inside": {"start": "ball:23,19,21,7vox", "balloon": -0.4},
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["gradient", "constant-density"])
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("noise", [0.0, 0.4], ids=["clean", "noisy"])
def test_a_ball_from_around_it_and_from_inside(noise, start, flow):
    """The area alone pulls a start around the ball onto it; from inside it takes a balloon beyond 2/r of the start."""
    image, truth, _ = ball(noise)
    result = segment(image, energy="geodesic", flow=flow, **STARTS[start])
    print(
        f"\n{start} {noise} {flow}: Dice {dice(result.labels, truth):.4f}, {result.stop.steps} steps"
    )
    assert result.stop.reason == "converged" and result.components == 1
    assert dice(result.labels, truth) > 0.97
    assert result.history[-1].potential < result.history[0].potential
    assert result.energy == "geodesic"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["gradient", "constant-density"])
def test_thick_slices_and_a_single_one(flow):
    spacing = (2.0, 1.0, 1.0)
    image, truth, _ = ball(0.0, (22, 42, 44), spacing)
    options = {"energy": "geodesic", "flow": flow}
    result = segment(
        image, spacing=spacing, start="ball:22,20,10,17.5vox", edge_scale=1.0, **options
    )
    assert dice(result.labels, truth) > 0.97
    y, x = np.indices((48, 52))
    circle = np.hypot(y - 23, x - 26)
    flat = segment(np.clip(15.5 - circle, 0, 1), start="ball:27,24,0,21vox", **options)
    assert dice(flat.labels[0], circle < 15) > 0.97


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_the_minimum_lies_inside_of_the_edge(scale):
    """Smoothing moves the edge of a ball inward by s^2/r, the area's pull about as much again: 0.22 and 0.435 mm."""
    image, _, _ = ball(0.0)
    result = segment(image, energy="geodesic", start="ball:22,20,20,17.5vox", edge_scale=scale)
    radius = (result.volume_mm3 / (4 / 3 * np.pi)) ** (1 / 3)
    assert 12.3 - radius == pytest.approx(12.3 - exact_minimum(scale), abs=0.03)


def exact_minimum(scale):
    """Radius at which r^2 phi(r) is least: phi of the exact smoothed ball, its slope by differences of a voxel."""
    sigma, r = (
        np.sqrt(scale**2 + 1 / 12),
        np.linspace(10, 14, 40_001),
    )  # the edge of the image is a ramp of one voxel

    def smoothed(r):
        a, b = ((12.3 + sign * r) / (np.sqrt(2) * sigma) for sign in (-1, 1))
        tails = np.exp(-(a**2)) - np.exp(-(b**2))
        return 0.5 * (special.erf(a) + special.erf(b)) - sigma / np.sqrt(2 * np.pi) / r * tails

    gradient = np.abs(smoothed(r + 1) - smoothed(r - 1)) / 2
    return r[np.argmin(r**2 / (1 + (gradient / (0.25 * gradient.max())) ** 2))]


def test_the_configuration_reaches_the_energy():
    image = ball(0.2)[0].astype(np.float32)
    config = RunConfig(
        energy="geodesic", smoothness=0.3, edge_scale=2.0, edge_contrast=0.05, balloon=-0.2
    )
    energy = make_energy(config, image, (1.0, 1.0, 1.0)).energy
    assert isinstance(energy, Geodesic) and energy.balloon == -0.2
    phi = edge_indicator(gradient_magnitude(image, (1, 1, 1), 2.0), 0.05)
    np.testing.assert_array_equal(energy.sums.image, phi.ravel())
    assert energy.alpha == pytest.approx(phi.max() + 0.3)
    auto = make_energy(RunConfig(energy="geodesic"), image, (1.0, 1.0, 1.0)).energy
    np.testing.assert_array_equal(
        auto.sums.image, edge_indicator(gradient_magnitude(image, (1, 1, 1), 1.0)).ravel()
    )


@pytest.mark.slow
def test_smoothness_keeps_the_surface_off_noise():
    image, _, _ = ball(0.4)
    rough, smooth = (
        segment(
            image, energy="geodesic", flow="gradient", start="ball:22,20,20,17.5vox", smoothness=a
        )
        for a in (0.0, 0.2)
    )
    assert smooth.area_mm2 < 0.99 * rough.area_mm2


def test_from_the_command_line(tmp_path):
    image, truth, _ = ball(0.0)
    io.write(Volume.from_array(image.astype(np.float32)), tmp_path / "ball.nii.gz")
    words = [
        "segment",
        tmp_path / "ball.nii.gz",
        "-o",
        tmp_path / "out",
        "--quiet",
        "--energy",
        "geodesic",
    ]
    assert cli.execute([str(w) for w in (*words, "--start", "ball:22,20,20,17.5vox")]) == 0
    report = json.loads((tmp_path / "out" / "ball_report.json").read_text())
    assert report["energy"]["name"] == report["config"]["energy"] == "geodesic"
    assert dice(io.read_labels(tmp_path / "out" / "ball_seg.nii.gz").array > 0, truth) > 0.97
