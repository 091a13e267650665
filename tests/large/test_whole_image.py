"""Numbers of an image that is read in parts have the bytes that they have of the image in memory."""

import pickle
from functools import partial

import numpy as np
import pytest

from accelsurf.energies import MomentTracker, Parzen
from accelsurf.energies.likelihood import least_variance
from accelsurf.energies.region_sums import RegionMoments, moments_of, sums_by_plane
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.pyramid import levels, restrict
from accelsurf.image.filters import ImageFilters
from accelsurf.image.noise import noise_of
from accelsurf.image.volume import Volume, check_image
from accelsurf.io.lazy_volume import LazyVolume
from accelsurf.large.whole_image import ImageSlabs, WholeImage
from accelsurf.run.preprocessing import apply_filters, filtered_volume, scale_of
from accelsurf.starts.region_growing import otsu_level

SPACING = (2.5, 1.0, 0.8)
SHAPES = {"even": (16, 40, 34), "odd": (19, 33, 41), "thin": (5, 61, 17), "flat": (1, 61, 47)}
DTYPES = (np.uint8, np.int16, np.uint16, np.int32, np.float32, np.float64)
#: Planes of a slab: one, an odd number that does not divide, more than there are.
SLABS = (1, 3, 1000)


def moments(whole, grids, level):
    return RegionMoments(*whole.sums(grids, level, "moments", moments_of).tolist())


def volume(shape, dtype, seed=0):
    """A soft blob with noise, values below 0 where the type has them."""
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(shape) - np.array([n / 2.1 for n in shape]).reshape(3, 1, 1, 1)
    blob = np.tanh((0.3 * shape[1] - np.sqrt((2.0 * z) ** 2 + y**2 + x**2)) / 2)
    values = 60 * blob + rng.normal(0, 15, shape) + (130 if np.dtype(dtype).kind == "u" else 5)
    return Volume.from_array(
        values.clip(0, 255).astype(dtype) if dtype == np.uint8 else values.astype(dtype), SPACING
    )


def in_parts(image, sigma, planes, **more):
    nz, ny, nx = image.geometry.shape
    return WholeImage(
        LazyVolume.of_array(image),
        ImageFilters(sigma=sigma),
        slab_bytes=4 * ny * nx * planes,
        **more,
    )


def same(got, want):
    got, want = np.asarray(got), np.asarray(want)
    assert got.dtype == want.dtype
    assert got.tobytes() == want.tobytes(), (got, want)


@pytest.mark.sampled
@pytest.mark.parametrize("sigma", [0.0, 1.3])
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_numbers_have_the_bytes_of_the_image_in_memory(shape, dtype, sigma):
    image = volume(shape, dtype)
    smoothed = filtered_volume(image, ImageFilters(sigma=sigma))
    scale = scale_of(smoothed)
    scaled = apply_filters(smoothed.copy(), scale)
    for planes in SLABS:
        whole = in_parts(image, sigma, planes)
        assert whole.scale == scale
        for q in (0.0, 20.0, 50.0, 73.21, 100.0, 99):
            same(whole.found(np.percentile, q), np.percentile(scaled, q))
        same(whole.found(np.ptp), np.ptp(scaled))
        assert whole.found(noise_of) == noise_of(scaled) > 0
        assert whole.found(otsu_level) == otsu_level(scaled)
        assert whole.found(least_variance) == least_variance(scaled)
        assert whole.found(Parzen.of_image).scale == Parzen.of_image(scaled).scale


@pytest.mark.parametrize("sigma", [0.0, 1.3])
@pytest.mark.parametrize("shape", [(16, 40, 34), (19, 33, 41), (37, 48, 50), (1, 61, 47)])
def test_sums_on_levels_have_the_bytes_of_the_image_in_memory(shape, sigma):
    image = volume(shape, np.int16)
    grids = levels(shape, SPACING, min_voxels=2)
    assert len(grids) > 2
    smooth = filtered_volume(image, ImageFilters(sigma=sigma))
    arrays = [apply_filters(smooth.copy(), scale_of(smooth))]
    for fine, coarse in zip(grids, grids[1:], strict=False):
        arrays.append(restrict(arrays[-1], fine, coarse))
    parzen = Parzen.of_image(arrays[0])
    for planes in (1, 5, 8, 1000):
        whole = in_parts(image, sigma, planes)
        for level in (len(grids) - 2, 0, len(grids) - 1):
            assert moments(whole, grids, level) == MomentTracker(arrays[level]).whole_image()
            same(
                whole.sums(grids, level, "h", parzen.histogram),
                sums_by_plane(arrays[level], parzen.histogram),
            )
        for level, array in enumerate(arrays):
            slabs = ImageSlabs(
                LazyVolume.of_array(image),
                ImageFilters(sigma=sigma),
                4 * shape[1] * shape[2] * planes,
            )
            parts = slabs.on_levels(grids, partial(apply_filters, scale=scale_of(smooth)))
            found = [slab for slab in parts if slab.level == level]
            assert [slab.first for slab in found] == list(
                np.cumsum([0, *(len(slab.values) for slab in found[:-1])])
            )
            same(np.concatenate([slab.values for slab in found]), array)


@pytest.mark.sampled
@pytest.mark.parametrize("sigma", [0.0, 0.15, 1.3, 20.0])
@pytest.mark.parametrize(
    "corner, shape", [((3, 5, 8), (4, 9, 2)), ((0, 0, 0), (1, 33, 5)), ((10, 20, 39), (9, 13, 2))]
)
def test_a_window_is_a_box_of_the_smoothed_whole(corner, shape, sigma):
    image = volume((19, 33, 41), np.float32)
    box = box_at(corner, shape)
    got = in_parts(image, sigma, 3).window(box)
    assert got.flags.c_contiguous
    same(got, filtered_volume(image, ImageFilters(sigma=sigma))[box])


def test_what_is_found_changes_no_input_and_is_read_once():
    image = volume((16, 40, 34), np.float32)
    before, source = image.array.copy(), LazyVolume.of_array(image)
    whole = WholeImage(source, slab_bytes=4 * 40 * 34 * 5)
    whole.window(whole_box(image.geometry.shape))[:] = 0
    size, grids = image.array.nbytes, levels(image.geometry.shape, SPACING)
    first = (
        whole.scale,
        whole.found(noise_of),
        moments(whole, grids, 1),
        whole.found(np.percentile, 31.0),
    )
    read = source.bytes_read
    assert read <= 6.5 * size
    again = (
        whole.scale,
        whole.found(noise_of),
        moments(whole, grids, 1),
        whole.found(np.percentile, 31.0),
    )
    assert source.bytes_read == read and again == first
    same(image.array, before)


def test_small_integers_are_read_once_for_the_scale():
    image = volume((16, 40, 34), np.uint16)
    source = LazyVolume.of_array(image)
    whole = WholeImage(source)
    assert whole.scale == scale_of(image.as_float32()) and whole.found(np.percentile, 40.0) > 0
    assert source.bytes_read == image.array.nbytes


@pytest.mark.sampled
@pytest.mark.parametrize("bad", ["nan", "inf", "many", "huge", "constant", "tiny"])
@pytest.mark.parametrize("planes", SLABS)
def test_images_that_cannot_be_used_are_refused_in_the_same_words(bad, planes):
    values = np.array(volume((9, 20, 21), np.float32).array)
    if bad == "constant":
        values[:] = 3.0
    elif bad == "tiny":
        values = (values * 1e-36).astype(np.float32)
    else:
        values[4, 7, 3] = {"nan": np.nan, "inf": -np.inf, "many": np.nan, "huge": 2e31}[bad]
        values[8, 2, 1] = np.inf if bad == "many" else values[8, 2, 1]
    image = Volume.from_array(values, SPACING)
    with pytest.raises(InputError) as want:
        check_image(image)
    with pytest.raises(InputError) as got:
        _ = in_parts(image, 0.0, planes).scale
    assert str(got.value) == str(want.value)
    if bad == "many":
        assert "2 voxels are (first at index x=3, y=7, z=4)" in str(got.value)


def test_an_image_of_two_values_is_scaled_by_its_extremes():
    values = np.zeros((4, 40, 40), np.uint8)
    values[2, 3, 3] = 7
    image = Volume.from_array(values)
    assert in_parts(image, 0.0, 1).scale == scale_of(image.as_float32()) == (0.0, 7.0)
    far = Volume.from_array(np.where(values > 0, 1e29, np.arange(40)).astype(np.float32))
    with pytest.raises(InputError, match="beyond") as want:
        scale_of(far.as_float32())
    with pytest.raises(InputError, match="beyond") as got:
        _ = in_parts(far, 0.0, 1).scale
    assert str(got.value) == str(want.value)


def test_numbers_of_a_coarser_level_are_those_of_it():
    image, coarse = volume((16, 40, 34), np.int16), volume((8, 20, 17), np.int16, seed=5)
    whole = in_parts(image, 0.0, 3, statistics_from=LazyVolume.of_array(coarse))
    alone = in_parts(coarse, 0.0, 3)
    assert in_parts(image, 0.0, 3).statistics == "exact"
    assert "17 x 20 x 8" in whole.statistics
    assert whole.scale == alone.scale and whole.found(otsu_level) == alone.found(otsu_level)
    grids = levels((16, 40, 34), SPACING)
    own = moments(alone, levels((8, 20, 17), SPACING), 0)
    for level in (0, 1):
        got = moments(whole, grids, level)
        assert got.voxels == pytest.approx(np.prod(grids[level].shape), rel=1e-12)
        assert got.total / got.voxels == pytest.approx(own.total / own.voxels, rel=1e-12)
        assert got.squares / got.voxels == pytest.approx(own.squares / own.voxels, rel=1e-12)
    same(whole.window(whole_box(image.geometry.shape)), image.as_float32())


def test_a_window_is_looked_at_where_the_numbers_are_of_a_coarser_level():
    image, coarse = volume((16, 40, 34), np.float32), volume((8, 20, 17), np.float32)
    image.array[9, 20, 15] = np.nan
    whole = in_parts(image, 0.0, 3, statistics_from=LazyVolume.of_array(coarse))
    assert np.isfinite(whole.window(box_at((0, 0, 0), (9, 40, 34)))).all() and whole.scale
    with pytest.raises(
        InputError, match=r"1 voxel is \(first at index x=15, y=20, z=9\) not finite"
    ):
        whole.window(box_at((4, 10, 10), (8, 20, 20)))


def test_what_needs_the_image_itself_is_named():
    with pytest.raises(ValueError, match="median"):
        in_parts(volume((16, 40, 34), np.int16), 0.0, 3).found(np.median)
    with pytest.raises(UsageError, match="presmooth"):
        in_parts(volume((16, 40, 34), np.int16), 1e6, 3)


def test_numbers_go_to_another_process():
    """One that gets them reads nothing of the image for what they tell."""
    image = Volume.from_array(
        np.random.default_rng(0).normal(0, 1, (12, 14, 16)).astype(np.float32)
    )
    first = WholeImage(LazyVolume.of_array(image))
    found = first.found(noise_of), first.found(np.percentile, 20.0), first.found(Parzen.of_image)
    numbers = pickle.loads(pickle.dumps(first.numbers))
    source = LazyVolume.of_array(image)
    second = WholeImage(source, numbers=numbers)
    assert (
        second.scale == first.scale
        and second.numbers.keys() == numbers.keys() == first.numbers.keys()
    )
    assert (second.found(noise_of), second.found(np.percentile, 20.0)) == found[:2]
    assert second.found(Parzen.of_image).scale == found[2].scale and source.bytes_read == 0
    assert second.found(np.ptp) == first.found(np.ptp) and source.bytes_read > 0
