import numpy as np
import pytest

import accelsurf
from accelsurf.api.segment import evolve, segment
from accelsurf.errors import InputError, UsageError
from accelsurf.image.filters import ImageFilters
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.phantoms.recipes import distance_at, make, recipe_from
from accelsurf.run.preprocessing import apply_filters, filtered_volume, scale_of
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

#: Antialiased: only then does the image tell where in a voxel the surface is.
BALL = {"kind": "ball", "radius": 15.3, "antialias": True}
CUBE = {"kind": "cube", "side": 26.0, "antialias": True}
GRIDS = {
    "isotropic": {"shape": [40, 40, 40], "spacing": [1.0, 1.0, 1.0]},
    "1 x 1 x 3 mm": {"shape": [40, 40, 14], "spacing": [1.0, 1.0, 3.0]},
    "oblique": {"shape": [40, 40, 40], "spacing": [1.0, 1.0, 1.0], "rotation": [20.0, -15.0, 35.0]},
    "oblique 1 x 1 x 3 mm": {
        "shape": [40, 40, 14],
        "spacing": [1.0, 1.0, 3.0],
        "rotation": [20.0, -15.0, 35.0],
    },
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("kind", [BALL, CUBE], ids=["ball", "cube"])
def test_clean_phantoms_from_a_start_that_touches_only_part(kind, grid):
    phantom = make(recipe_from({**kind, **GRIDS[grid]}))
    # In a corner of the object, partly outside it; world coordinates follow the turned grid.
    geometry = phantom.image.geometry
    middle = geometry.world_to_index(geometry.center_world())
    center = geometry.index_to_world(middle + 9.0 / np.array(geometry.spacing))
    start = "ball:" + ",".join(f"{v:.3f}" for v in center) + ",6"
    result = segment(phantom.image, start=start, epsilon=0)
    assert result.stop.reason == "converged"
    assert dice(result.labels, phantom.truth.array) >= 0.99
    error = np.abs(distance_at(phantom.recipe, result.surface.vertices))
    # The edges of a cube are rounded by any grid, so there the largest error is that of a voxel's diagonal.
    voxel = max(geometry.spacing)
    assert np.percentile(error, 99) <= 0.5 * voxel
    assert error.mean() <= 0.15 * voxel
    if kind is BALL:
        assert error.max() <= 0.5 * min(geometry.spacing)
        assert result.volume_mm3 == pytest.approx(phantom.volume_mm3, rel=0.02)
        assert result.area_mm2 == pytest.approx(phantom.area_mm2, rel=0.03)
    assert result.components == 1 and not result.touches_border


def noisy(seed=0, shape=(30, 34, 38)):
    z, y, x = np.indices(shape)
    ball = (z - 15) ** 2 + (y - 17) ** 2 + (x - 19) ** 2 < 9**2
    return (ball * 100 + np.random.default_rng(seed).normal(0, 40, shape)).astype(np.float32)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["constant-density", "gradient"])
@pytest.mark.threads
def test_same_bytes_twice_and_for_any_number_of_threads(flow):
    image = noisy(shape=(48, 48, 48))
    options = {"start": "ball:19,17,15,6", "flow": flow, "max_steps": 40}
    runs = [segment(image, threads=threads, **options) for threads in (1, 1, 2, 3)]
    for run in runs[1:]:
        assert run.labels.tobytes() == runs[0].labels.tobytes()
        assert run.psi.tobytes() == runs[0].psi.tobytes()
        assert [row.potential for row in run.history] == [row.potential for row in runs[0].history]


def test_the_image_is_never_modified():
    image = noisy()
    before = image.copy()
    image.flags.writeable = False
    segment(image, start="ball:19,17,15,6", max_steps=10, presmooth=1.0)
    np.testing.assert_array_equal(image, before)


def test_scale_and_offset_of_the_image_do_not_matter():
    image = noisy()
    one, four, other = (
        segment(i, start="ball:19,17,15,6", smoothness=0.1)
        for i in (image, 4 * image, 0.01 * image + 7)
    )
    # A factor of 4 rounds nothing; other factors round each voxel, and in noise a run multiplies that.
    np.testing.assert_array_equal(four.labels, one.labels)
    assert dice(one.labels, other.labels) > 0.98


def test_a_dark_object_is_found_as_well():
    """The two images are scaled to 0..1 with other roundings, and in noise that turns a voxel in a thousand."""
    image = noisy()
    one, other = (segment(i, start="ball:19,17,15,6") for i in (image, -image))
    assert dice(one.labels, other.labels) > 0.998


def test_smoothness_smooths():
    rough, smooth = (segment(noisy(), start="ball:19,17,15,6", smoothness=a) for a in (0.0, 0.3))
    assert smooth.area_mm2 < 0.9 * rough.area_mm2


def test_units_are_mm():
    """The same object on voxels of half the size: the same volume, area and number of steps."""
    z, y, x = np.indices((32, 32, 32)) - 15.5
    image = np.tanh((9 - np.sqrt(z**2 + y**2 + x**2)) / 2)
    one = segment(image, spacing=1.0, start="ball:12,14,15,5vox", smoothness=0.2)
    half = segment(image, spacing=0.5, start="ball:12,14,15,5vox", smoothness=0.1)
    assert half.volume_mm3 == pytest.approx(one.volume_mm3 / 8, rel=1e-3)
    assert half.area_mm2 == pytest.approx(one.area_mm2 / 4, rel=1e-3)
    assert half.stop.steps == one.stop.steps


def test_axes_and_flips_do_not_matter():
    image = noisy()
    one = segment(image, start="ball:19,17,15,6", smoothness=0.1, max_steps=120)
    turned = segment(
        np.ascontiguousarray(image.transpose(2, 0, 1)),
        start="ball:17,15,19,6",
        smoothness=0.1,
        max_steps=120,
    )
    flipped = segment(
        np.ascontiguousarray(image[::-1]), start="ball:19,17,14,6", smoothness=0.1, max_steps=120
    )
    assert dice(turned.labels.transpose(1, 2, 0), one.labels) > 0.99
    # In noise rounding decides details, and here even which window of the stop rule is the last.
    assert dice(flipped.labels[::-1], one.labels) > 0.98


def test_a_slice_is_a_volume():
    y, x = np.indices((60, 64))
    image = ((y - 30) ** 2 + (x - 30) ** 2 < 18**2) * 1.0
    result = segment(image, start="ball:22,22,0,6vox")
    assert dice(result.labels[0], image) >= 0.99
    assert result.volume_mm3 == pytest.approx(np.pi * 18**2, rel=0.02)
    assert result.area_mm2 == pytest.approx(2 * np.pi * 18, rel=0.03)


def test_an_object_cut_by_the_border():
    z, y, x = np.indices((28, 28, 28))
    image = ((z - 2) ** 2 + (y - 14) ** 2 + (x - 26) ** 2 < 10**2) * 1.0
    result = segment(image, start="ball:24,14,5,4vox")
    assert result.stop.reason == "converged"
    assert dice(result.labels, image) >= 0.99
    assert result.touches_border
    assert result.surface.is_closed


def test_vanished_and_filled():
    z, y, x = np.indices((24, 24, 24))
    image = ((z - 4) ** 2 + (y - 4) ** 2 + (x - 4) ** 2 < 9) * 1.0
    gone = segment(image, start="ball:18,18,18,3vox", smoothness=5.0)
    assert gone.stop.reason == "vanished"
    assert not gone.labels.any() and gone.volume_mm3 == 0
    # A dark centre in a bright box, started just inside the border: the two fits push it out.
    image = 1.0 * (np.maximum(np.maximum(abs(z - 11.5), abs(y - 11.5)), abs(x - 11.5)) < 11)
    full = segment(image, start="box:1.2,1.2,1.2,21.8,21.8,21.8vox")
    assert full.stop.reason in ("filled", "converged")
    assert full.labels.mean() > 0.7


def test_options_win_over_the_configuration():
    config = RunConfig(start="ball:19,17,15,6", max_steps=3)
    result = segment(noisy(), config=config, max_steps=5)
    assert (
        result.config.max_steps == 5
        and result.stop.reason == "max-steps"
        and result.stop.steps == 5
    )
    with pytest.raises(UsageError, match="max_step: there is no such setting"):
        segment(noisy(), config=config, max_step=5)


def test_on_step_may_end_the_run():
    rows = []
    result = segment(
        noisy(), start="ball:19,17,15,6", on_step=lambda row: rows.append(row) or len(rows) == 4
    )
    assert result.stop.reason == "interrupted" and result.stop.steps == 4
    assert result.report["status"] == "interrupted" and result.report["exit_code"] == 130
    assert rows == result.history


def test_evolve_yields_the_same_run():
    options = {"start": "ball:19,17,15,6", "max_steps": 12}
    result = segment(noisy(), **options)
    steps = list(evolve(noisy(), **options))
    assert [s.record.potential for s in steps] == [row.potential for row in result.history]
    np.testing.assert_array_equal(steps[-1].surface.labels, result.labels)


def test_what_cannot_be_segmented_is_refused():
    with pytest.raises(InputError, match="constant"):
        segment(np.zeros((8, 8, 8)))
    image = noisy()
    image[3, 4, 5] = np.nan
    with pytest.raises(InputError, match="1 NaN"):
        segment(image)
    with pytest.raises(InputError, match="spacing given together"):
        segment(Volume.from_array(noisy()), spacing=1.0)
    with pytest.raises(InputError, match="dimensions|shape"):
        segment(np.zeros((2, 8, 8, 8)))


def test_presmoothing_is_in_mm_and_spares_the_missing_axis():
    image = np.zeros((1, 17, 17))
    image[0, 8, 8] = 1
    volume = Volume.from_array(image, (1.0, 0.5, 1.0))
    smooth = filtered_volume(volume, ImageFilters(sigma=1.0))
    # Two voxels along y are one along x: the same distance, the same value (but for the kernel's sampling).
    assert smooth[0, 10, 8] == pytest.approx(smooth[0, 8, 9], rel=0.02)
    assert smooth.sum() == pytest.approx(1, rel=1e-3)
    np.testing.assert_array_equal(filtered_volume(volume, ImageFilters(sigma=0.0)), volume.array)


def test_scaled_puts_the_percentiles_at_0_and_1():
    image = np.arange(2000, dtype=np.float32).reshape(10, 10, 20)
    low, high = np.percentile(apply_filters(image.copy(), scale_of(image)), [0.5, 99.5])
    assert (low, high) == pytest.approx((0.0, 1.0), abs=1e-5)
    # A tiny object on a flat background: the percentiles coincide, the extremes do not.
    image[:] = 0
    image[0, 0, 0] = 4
    assert apply_filters(image.copy(), scale_of(image)).max() == 1


def test_the_run_is_made_of_what_the_configuration_says():
    config = RunConfig(
        start="ball:19,17,15,6",
        flow="gradient",
        diffusion=0.5,
        cfl=0.3,
        percentile=80,
        restart="off",
    )
    run = Run(Volume.from_array(noisy()), config)
    evolution = run.objects[0].evolution
    assert evolution.setup.limits.cfl == 0.3 and evolution.setup.limits.percentile == 80
    assert evolution.setup.restart is None and evolution.flow.name == "gradient"


def test_the_report_has_what_the_run_took_from_image_and_grid():
    image = make(
        recipe_from({"kind": "ball", "radius": 12, "shape": [48, 48, 24], "spacing": [1, 1, 2]})
    ).image
    image = image.with_array(image.array * 3.0 + 7.0)
    found = segment(image, start="ball:0,0,0,6", presmooth="1.5vox").report["resolved_settings"]
    assert found["presmooth_mm"] == 1.5  # of the smallest spacing
    (scale_,) = found["scale"]
    smooth = filtered_volume(image, ImageFilters(sigma=1.5))
    assert (scale_["at_0"], scale_["at_1"]) == pytest.approx(
        tuple(np.percentile(smooth, [0.5, 99.5])), rel=1e-5
    )
    assert found["levels"] == 2 and found["half_width_voxels"] == 3
    assert (found["flow"], found["diffusion"]) == ("constant-density", "free")
    assert found["stop"] == {"voxels": 0.1, "steps": 6} and found["step_voxels"] == 0.5
    other = {
        "start": "ball:0,0,0,6",
        "flow": "gradient",
        "levels": 1,
        "cfl": 0.3,
        "tolerance": 0.2,
        "half_width": 4,
    }
    found = segment(image, **other).report["resolved_settings"]
    assert found["levels"] == 1 and found["diffusion"] == 0.0 and found["half_width_voxels"] == 4
    assert found["stop"] == {"voxels": 0.2, "steps": 20} and found["step_voxels"] == 0.3


def test_public_names():
    assert accelsurf.segment is segment and accelsurf.evolve is evolve
