"""Runs on images that are read in parts: the bytes of a run on the whole image, within the memory that is allowed."""

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import LazyVolume
from accelsurf.large.windowed import LargeImage, segment_in_windows
from accelsurf.run.arguments import with_options
from accelsurf.run.memory import run_bytes

SPACING = (1.2, 1.0, 1.0)
SHAPE = (97, 110, 123)
MUCH = 10**11


@pytest.fixture(scope="module")
def image():
    """A ball of radius 14 in noise, and a second one elsewhere."""
    rng = np.random.default_rng(1)
    z, y, x = np.indices(SHAPE).astype(np.float32)
    one = np.sqrt(((z - 50) * 1.2) ** 2 + (y - 60) ** 2 + (x - 70) ** 2)
    other = np.sqrt(((z - 80) * 1.2) ** 2 + (y - 90) ** 2 + (x - 20) ** 2)
    values = 100 * (one < 14) + 60 * (other < 9) + rng.normal(0, 12, SHAPE)
    return Volume.from_array(values.astype(np.float32), SPACING)


@pytest.fixture
def small_windows(monkeypatch):
    """First windows hardly larger than the start."""
    monkeypatch.setattr("accelsurf.large.first_window.MIN_MARGIN", 9)


def both(image, **options):
    """The result in memory, that in windows, and the windows."""
    config, _ = with_options(None, None, {"threads": 1, **options})
    windows = []
    large = LargeImage((LazyVolume.of_array(image),), MUCH)
    result = segment_in_windows(large, config, on_window=windows.append)
    return accelsurf.segment(image, config=config), result, windows


def assert_same(whole, part):
    """Labels, psi near the surface, mesh and measures are the same."""
    labels = np.zeros(whole.labels.shape, np.uint8)
    labels[part.window.box] = part.labels
    assert np.array_equal(labels, whole.labels)
    there = whole.psi[part.window.box]
    near = np.abs(there) < 2.0
    assert near.any() and np.array_equal(there[near], part.psi[near])
    assert np.array_equal(part.surface.vertices.astype("<f4"), whole.surface.vertices.astype("<f4"))
    assert np.array_equal(part.surface.faces, whole.surface.faces)
    # A run that was stopped has looked for the closest points of its band once more.
    rows = [
        [row._replace(seconds=0.0, cells_visited=0) for row in one.history] for one in (whole, part)
    ]
    assert rows[0] == rows[1]
    assert repr(part.quality) == repr(whole.quality)
    grown = [
        one and tuple(float(v) for v in one) for one in (whole.late_leakage, part.late_leakage)
    ]
    corner = part.window.corner
    assert grown[0] == (
        grown[1] and tuple(v + first for v, first in zip(grown[1], corner, strict=True))
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "options",
    [
        {"start": "ball:66,57,56,5", "presmooth": 1.0},
        {"start": "ball:66,57,56,5", "presmooth": 0.7, "closing": 2.0, "clip": ",120"},
        {"start": "ball:66,57,47,5vox", "levels": 1},
        {"start": "box:64,54,44,74,64,54vox", "energy": "threshold:50,"},
        {"start": "ball:66,57,56,5", "energy": "threshold:learned,learned", "presmooth": 1.0},
        {"start": "ball:66,57,56,5", "energy": "threshold:40%,", "presmooth": 1.5, "max_steps": 12},
        {
            "start": "ball:66,57,56,5",
            "energy": "threshold:auto,",
            "presmooth": 1.5,
            "max_steps": 12,
        },
        {"start": "ball:66,57,56,5", "energy": "likelihood", "presmooth": 0.7},
        {
            "start": "ball:66,57,56,5",
            "energy": "likelihood:update=no",
            "presmooth": 0.7,
            "max_steps": 20,
        },
        {"start": "ball:66,57,56,5", "energy": "likelihood:model=histogram", "presmooth": 1.0},
        {"start": "ball:66,57,56,5", "flow": "sobolev", "presmooth": 1.0, "max_steps": 40},
        {
            "start": "ball:66,57,56,5",
            "presmooth": 1.0,
            "extension": "fast-marching",
            "max_steps": 30,
        },
    ],
    ids=lambda options: " ".join(f"{v}" for v in options.values()),
)
def test_a_run_in_windows_has_the_bytes_of_the_run_in_memory(image, options):
    whole, part, windows = both(image, **options)
    assert windows[-1].shape != SHAPE, "the window is the whole image: nothing is tested"
    assert_same(whole, part)


@pytest.mark.slow
def test_clicks_on_both_sides_and_corrections_of_windows(image):
    far = Volume.from_array(np.pad(image.array, 40, mode="reflect"), SPACING)
    whole, part, windows = both(
        far, inside=("point:110,100,108",), outside=("ball:110,125,108,2",), size="12000mm3"
    )
    assert windows[-1].shape != far.geometry.shape
    assert_same(whole, part)


def test_a_small_start_makes_the_window_larger_until_the_object_fits(image, small_windows):
    whole, part, windows = both(image, start="ball:70,60,60,3", presmooth=1.0, levels=1)
    shapes = [np.prod(one.shape) for one in windows]
    assert len(windows) > 1 and shapes == sorted(shapes)
    assert_same(whole, part)


def test_a_window_without_the_guard_gives_other_bytes(image, small_windows, monkeypatch):
    monkeypatch.setattr("accelsurf.grid.window.GUARD", -99)
    config, _ = with_options(
        None, None, {"threads": 1, "start": "ball:70,60,60,3", "presmooth": 1.0, "levels": 1}
    )
    part = segment_in_windows(LargeImage((LazyVolume.of_array(image),), MUCH), config)
    whole = accelsurf.segment(image, config=config)
    labels = np.zeros(SHAPE, np.uint8)
    labels[part.window.box] = part.labels
    assert not np.array_equal(labels, whole.labels)


def test_a_region_of_interest_is_scaled_by_its_own_values(image):
    whole, part, _ = both(image, start="ball:66,57,56,5", roi="40,30,30,105,95,100", presmooth=1.0)
    assert_same(whole, part)
    whole, part, _ = both(image, inside="ball:70,60,60,3", box="48,38,38,92,82,85")
    assert_same(whole, part)
    # Voxel indices are those of the whole image, and the size that a box tells is that of the whole box.
    whole, part, _ = both(image, inside="ball:70,60,60,3", box="64,54,45,112,104,88vox")
    assert_same(whole, part)


def test_channels_are_read_in_the_same_windows(image):
    other = Volume(np.flip(image.array, 2).copy() * 0.5 + image.array, image.geometry)
    config, _ = with_options(
        None, None, {"threads": 1, "start": "ball:66,57,56,5", "presmooth": 1.0}
    )
    large = LargeImage((LazyVolume.of_array(image), LazyVolume.of_array(other)), MUCH)
    assert_same(
        accelsurf.segment(image, channels=[other], config=config), segment_in_windows(large, config)
    )


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [16, 27, 64])
def test_the_size_of_a_stores_bricks_changes_nothing(image, chunk, tmp_path):
    zarr = pytest.importorskip("zarr")
    values = np.clip(image.array, 0, 255).astype(np.uint8)
    io.write(Volume(values, image.geometry), tmp_path / "a.ome.zarr")
    store = zarr.open_group(tmp_path / "a.ome.zarr", mode="a")
    path = store.attrs["ome"]["multiscales"][0]["datasets"][0]["path"]
    del store[path]
    store.create_array(path, data=values, chunks=(chunk,) * 3)
    config, _ = with_options(
        None, None, {"threads": 1, "start": "ball:66,57,56,5", "presmooth": 1.0}
    )
    part = segment_in_windows(LargeImage((io.open_volume(tmp_path / "a.ome.zarr"),), MUCH), config)
    assert_same(accelsurf.segment(Volume(values, image.geometry), config=config), part)


def test_the_memory_that_is_allowed_is_held_or_refused_with_the_estimate(image, small_windows):
    config, _ = with_options(
        None, None, {"threads": 1, "start": "ball:70,60,60,3", "presmooth": 1.0, "levels": 1}
    )
    lazy = LazyVolume.of_array(image)
    # What the object needs and little more: the window grows as far as that goes, and no farther.
    allowed = run_bytes(70 * 80 * 80, clicks=False)
    windows = []
    result = segment_in_windows(LargeImage((lazy,), allowed), config, on_window=windows.append)
    assert all(run_bytes(int(np.prod(one.shape)), clicks=False) <= allowed for one in windows)
    assert_same(accelsurf.segment(image, config=config), result)
    with pytest.raises(InputError, match=r"needs a window of .* takes about .* allowed") as refused:
        segment_in_windows(LargeImage((lazy,), run_bytes(44**3, clicks=False)), config)
    assert "--level" in refused.value.hint


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"start": "otsu"}, "looks at values everywhere"),
        (
            {"start": "ball:66,57,56,5", "energy": "local-region"},
            "local-region looks at the whole image",
        ),
        ({"start": "ball:66,57,56,5", "edit": ("step=3 smoothness=1",)}, "edit: it was given"),
        ({"start": "ball:500,57,56,5"}, "no voxel centre is inside"),
        ({"start": "ball:66,57,56,5", "flow": "flowable-mass"}, "flow: flowable-mass"),
        ({"start": "ball:66,57,56,5", "noise": 0.5}, "noise: 0.5"),
    ],
)
def test_what_needs_the_whole_image_is_refused_in_one_line(image, options, what):
    config, _ = with_options(None, None, {"threads": 1, **options})
    with pytest.raises((UsageError, InputError), match=what):
        segment_in_windows(LargeImage((LazyVolume.of_array(image),), MUCH), config)


def test_a_run_that_was_stopped_goes_on_in_its_window(image, small_windows, tmp_path):
    options = {
        "threads": 1,
        "start": "ball:70,60,60,3",
        "presmooth": 1.0,
        "levels": 1,
        "checkpoint": 5,
    }
    config, _ = with_options(None, None, options)
    large, file = LargeImage((LazyVolume.of_array(image),), MUCH), tmp_path / "state.npz"
    windows, steps = [], []

    class Killed(Exception):
        pass

    def kill(record, own):
        steps.append(record.step)
        if len(windows) > 1 and record.step == 22:
            raise Killed

    with pytest.raises(Killed):
        segment_in_windows(large, config, kill, on_window=windows.append, checkpoint_to=file)
    assert file.exists()
    again, later = [], []
    part = segment_in_windows(
        large,
        config,
        lambda record, own: later.append(record.step),
        on_window=again.append,
        checkpoint_to=file,
    )
    assert again[0] == windows[-1] and min(later) > 15
    assert_same(accelsurf.segment(image, config=config.replace(checkpoint=None)), part)


def test_python_reads_a_large_image_in_parts(image):
    options = {"start": "ball:66,57,56,5", "presmooth": 1.0, "threads": 1}
    part = accelsurf.segment(LazyVolume.of_array(image), max_memory="2GB", **options)
    assert_same(accelsurf.segment(image, **options), part)
    with pytest.raises(UsageError, match="start: an array or a function was given"):
        accelsurf.segment(LazyVolume.of_array(image), start=image.array > 50)
    with pytest.raises(UsageError, match="max_memory"):
        accelsurf.segment(image, max_memory="2GB", **options)


def test_statistics_of_an_image_with_many_voxels_are_those_of_a_coarser_level(
    image, tmp_path, monkeypatch
):
    pytest.importorskip("zarr")
    values = np.clip(image.array, 0, 255).astype(np.uint8)
    io.write(Volume(values, image.geometry), tmp_path / "a.ome.zarr")
    monkeypatch.setattr("accelsurf.large.windowed.MAX_STREAMED", values.size // 4)
    options = {"start": "ball:66,57,56,5", "presmooth": 0.0, "max_steps": 30, "threads": 1}
    fine = io.open_volume(tmp_path / "a.ome.zarr")
    coarse = fine.coarser()
    assert coarse.geometry.shape == tuple(-(-n // 2) for n in SHAPE)
    result = accelsurf.segment(fine, **options)
    where = " x ".join(str(n) for n in reversed(coarse.geometry.shape))
    assert (
        f"values of the whole image are those of a coarser level of {where} voxels"
        in result.warnings
    )
    low, high = result.resolved_settings["scale"][0].values()
    of_coarse = np.percentile(
        coarse.read(tuple(slice(0, n) for n in coarse.geometry.shape)), (0.5, 99.5)
    )
    assert [low, high] == of_coarse.tolist() and high != np.percentile(values, 99.5)
    whole = accelsurf.segment(Volume(values, image.geometry), **options)
    assert abs(result.volume_mm3 - whole.volume_mm3) < 0.02 * whole.volume_mm3


def test_an_image_without_coarser_levels_is_read_through(image, tmp_path, monkeypatch):
    monkeypatch.setattr("accelsurf.large.windowed.MAX_STREAMED", 1000)
    io.write(image, tmp_path / "a.nii")
    options = {"start": "ball:66,57,56,5", "presmooth": 1.0, "threads": 1}
    whole = accelsurf.segment(io.read(tmp_path / "a.nii"), **options)
    assert_same(whole, accelsurf.segment(io.open_volume(tmp_path / "a.nii"), **options))


def test_a_click_that_needs_too_much_is_told_to_say_a_size(image):
    large = LargeImage((LazyVolume.of_array(image),), run_bytes(50**3, clicks=True))
    for options, said in (({}, True), ({"size": "900ml"}, False)):
        config, _ = with_options(None, None, {"inside": "ball:70,60,60,3", **options})
        with pytest.raises(InputError) as refused:
            segment_in_windows(large, config)
        assert ("--size" in refused.value.hint) == said


@pytest.mark.sampled(1)
@pytest.mark.parametrize("levels", [1, 2])
def test_a_plateau_and_its_place_are_those_of_the_whole_image(small_windows, levels):
    """A ball with a thin way to a larger one: the surface rests, then bursts through, far from the window's corner."""
    z, y, x = np.indices((80, 72, 90)).astype(np.float32)
    off = (y - 36) ** 2 + (z - 40) ** 2
    balls = ((x - 30) ** 2 + off < 81) | ((x - 55) ** 2 + off < 100)
    way = (off < 4) & (x > 30) & (x < 55) & ~balls
    values = (
        100 * balls
        + (55 if levels == 1 else 90) * way
        + np.random.default_rng(2).normal(0, 5, balls.shape)
    )
    image = Volume(
        values.astype(np.float32), Geometry(balls.shape, (1.0, 1.0, 1.0), (0.1, 0.3, 0.7))
    )
    settings = {"energy": "threshold:50,", "smoothness": 0.05, "flow": "constant-density"}
    whole, part, _ = both(image, start="ball:30,36,40,3", levels=levels, **settings)
    assert part.window.corner != (0, 0, 0)
    assert_same(whole, part)
    (one,), (other,) = whole.objects, part.objects
    assert len(one.plateaus) == (1 if levels == 1 else len(other.plateaus))
    for rest, own in zip(one.plateaus, other.plateaus, strict=True):
        assert rest == own
