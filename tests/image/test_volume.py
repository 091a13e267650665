import numpy as np
import pytest

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume, check_image

GRID = Geometry((2, 3, 4), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("dtype", [bool, "u1", "i2", ">i2", "u8", "f2", "f4", "f8", ">f8"])
def test_every_real_type_becomes_contiguous_float32(dtype):
    array = (np.arange(24).reshape(2, 3, 4) % 2).astype(dtype)
    values = Volume(array, GRID).as_float32()
    assert values.dtype == np.float32 and values.dtype.isnative and values.flags.c_contiguous
    np.testing.assert_array_equal(values, array.astype(float))


def test_the_input_is_never_modified():
    array = np.zeros((2, 3, 4), np.float32)
    volume = Volume(array, GRID)
    volume.as_float32()[:] = 1
    assert not array.any()
    array.setflags(write=False)
    assert volume.as_float32().flags.writeable


def test_a_view_in_another_order_is_accepted():
    array = np.arange(24.0).reshape(4, 3, 2).transpose(2, 1, 0)
    values = Volume(array, GRID).as_float32()
    assert values.flags.c_contiguous
    np.testing.assert_array_equal(values, array)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((2, 3)), "2 dimensions"),
        (np.zeros((2, 3, 4, 5)), "4 dimensions"),
        (np.zeros((2, 3, 5)), r"shape \(2, 3, 5\) given"),
        (np.zeros((2, 3, 4), complex), "complex128"),
        (np.full((2, 3, 4), "a"), "<U1"),
        (np.full((2, 3, 4), None), "object"),
        ([[[0]]], "list given"),
    ],
)
def test_what_is_no_volume_is_refused_in_words(array, words):
    with pytest.raises(InputError, match=words):
        Volume(array, GRID)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ([np.nan], r"1 voxel is \(first at index x=3, y=2, z=0\) not finite \(1 NaN, 0 infinite\)"),
        (
            [np.nan, np.inf, -np.inf],
            r"3 voxels are \(first at index x=3, y=2, z=0\) not finite \(1 NaN, 2 infinite\)",
        ),
    ],
)
@pytest.mark.parametrize("use", [Volume.as_float32, check_image])
def test_values_that_are_not_finite_are_counted_and_placed(bad, words, use):
    array = np.zeros((2, 3, 4))
    array.ravel()[11 : 11 + len(bad)] = bad
    with pytest.raises(InputError, match=words) as caught:
        use(Volume(array, GRID))
    assert "nan_to_num" in caught.value.hint


def test_the_advice_for_values_that_are_not_finite_works():
    array = np.arange(24.0).reshape(2, 3, 4)
    array[0, 0, :3] = np.nan, np.inf, -np.inf
    volume = Volume(array, GRID)
    with pytest.raises(InputError, match="not finite"):
        check_image(volume)
    better = volume.with_array(np.nan_to_num(volume.array, posinf=0, neginf=0))
    check_image(better)
    np.testing.assert_array_equal(better.as_float32().ravel(), [0, 0, 0, *range(3, 24)])


def test_values_beyond_float32_are_refused():
    array = np.zeros((2, 3, 4))
    array[1, 1, 1] = 1e300
    with pytest.raises(
        InputError, match=r"1 voxel is \(first at index x=1, y=1, z=1\) beyond the range of 32-bit"
    ):
        Volume(array, GRID).as_float32()


@pytest.mark.parametrize("dtype", [np.uint8, np.float64, bool])
def test_a_constant_image_is_refused(dtype):
    with pytest.raises(InputError, match="constant: every voxel is"):
        check_image(Volume(np.ones((2, 3, 4), dtype), GRID))


def test_an_image_of_two_values_is_an_image():
    array = np.zeros((2, 3, 4), bool)
    with pytest.raises(InputError, match="constant"):
        check_image(Volume(array, GRID))
    array[0, 0, 0] = True
    image = Volume(array, GRID)
    check_image(image)
    assert image.as_float32().sum() == 1.0


@pytest.mark.parametrize(
    ("shape", "spacing", "expected"),
    [
        ((2, 3, 4), 2, (2.0, 2.0, 2.0)),
        ((2, 3, 4), np.float32(2), (2.0, 2.0, 2.0)),
        ((2, 3, 4), (3, 2, 1), (3.0, 2.0, 1.0)),
        ((2, 3, 4), np.array([3, 2, 1]), (3.0, 2.0, 1.0)),
        ((3, 4), (2, 1), (1.0, 2.0, 1.0)),
        ((3, 4), (5, 2, 1), (5.0, 2.0, 1.0)),
    ],
)
def test_from_array_takes_spacing_in_array_order(shape, spacing, expected):
    volume = Volume.from_array(np.zeros(shape), spacing)
    assert volume.geometry.spacing == expected
    assert volume.array.ndim == 3 and volume.array.shape[-2:] == shape[-2:]


def test_from_array_places_the_grid():
    direction = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    volume = Volume.from_array(np.zeros((2, 3, 4)), 1, origin=(1, 2, 3), direction=direction)
    assert volume.geometry.origin == (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(volume.geometry.direction, direction)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3, 4, 3), (0, 3, 4), (0, 4)])
def test_from_array_refuses_other_shapes(shape):
    with pytest.raises(InputError, match="shape"):
        Volume.from_array(np.zeros(shape))


@pytest.mark.parametrize("spacing", [0, -1, (1, 1), (1, 1, 1, 1), np.nan])
def test_from_array_refuses_spacing_that_is_none(spacing):
    with pytest.raises(GeometryError, match="spacing"):
        Volume.from_array(np.zeros((2, 3, 4)), spacing)


def test_another_array_on_the_same_grid_keeps_the_header_and_not_the_source(tmp_path):
    volume = Volume(np.zeros((2, 3, 4)), GRID, {"key": "value"}, tmp_path)
    labels = volume.with_array(np.ones((2, 3, 4), np.uint8))
    assert labels.geometry is GRID and labels.metadata == {"key": "value"} and labels.source is None
    labels.metadata["key"] = "other"
    assert volume.metadata == {"key": "value"}
    with pytest.raises(InputError, match="shape"):
        volume.with_array(np.zeros((4, 3, 2)))


def test_repr_is_one_short_line(tmp_path):
    volume = Volume(np.zeros((2, 3, 4), np.float32), GRID, source=tmp_path / "scan.nii")
    text = repr(volume)
    assert (
        "\n" not in text
        and "float32" in text
        and f"shape={GRID.shape}" in text
        and "scan.nii" in text
    )
    assert len(repr(Volume.from_array(np.zeros((50, 60, 70))))) < 120


def test_repr_of_a_geometry_names_a_direction_only_when_it_has_one():
    assert repr(Geometry((5, 4, 3), (2, 1, 0.5))) == (
        "Geometry(shape=(5, 4, 3), spacing=(2.0, 1.0, 0.5), origin=(0.0, 0.0, 0.0))"
    )
    flipped = np.diag([-1.0, -1.0, 1.0])
    assert repr(Geometry((5, 4, 3), (2, 1, 0.5), direction=flipped)).endswith(
        f"direction={flipped.tolist()})"
    )
