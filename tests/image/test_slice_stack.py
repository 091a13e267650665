"""Slices along the voxels and straight ones: where each pixel lies in the world, and its value."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.image.slice_stack import FINE, SliceStack, linear

TURNED = Rotation.from_euler("xyz", [11, -17, 23], degrees=True).as_matrix()
#: Rotated; rotated, with axes exchanged and left-handed; a gantry's tilt; parallel and flipped.
DIRECTIONS = {
    "turned": TURNED,
    "exchanged": TURNED[:, [2, 0, 1]] * [1.0, -1.0, 1.0],
    "tilted": Rotation.from_euler("x", 16.5, degrees=True).as_matrix() @ np.diag([-1.0, -1.0, 1.0]),
    "flipped": np.diag([-1.0, -1.0, 1.0]),
}
#: World axis to the right, up (front at the top of an axial slice), across, with its sign.
HANGS = (((0, 1), (1, -1), (2, 1)), ((0, 1), (2, 1), (1, 1)), ((1, 1), (2, 1), (0, 1)))


@pytest.fixture(params=sorted(DIRECTIONS))
def geometry(request):
    return Geometry((13, 22, 17), (2.4, 0.8, 1.1), (31.0, -12.0, 7.5), DIRECTIONS[request.param])


def values_of(world):
    """A linear function of the world, which is exact between voxels."""
    return 3.0 + world @ np.array([1.7, -0.6, 2.3])


def image_of(geometry):
    index = np.moveaxis(np.indices(geometry.shape), 0, -1)
    return values_of(geometry.index_to_world(index)).astype(np.float32)


def pixels_of(stack, fine=1):
    """Place (right, up) of each pixel, (rows, columns, 2)."""
    left, right, bottom, top = stack.extent
    rows, columns = stack.size(fine)
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    y = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)


def world_of(plane, places, across):
    """World mm of places in a straight slice, by the table of how slices hang."""
    world = np.empty((*places.shape[:-1], 3))
    for value, (axis, sign) in zip(
        (places[..., 0], places[..., 1], across), HANGS[plane], strict=True
    ):
        world[..., axis] = sign * value
    return world


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_pixels_along_voxels_are_the_voxels(geometry, plane):
    stack, image = SliceStack.along_voxels(geometry, plane), image_of(geometry)
    assert (
        stack.axis == DisplayOrientation.of(geometry).order[plane]
        and stack.count == geometry.shape[stack.axis]
    )
    for number in (0, 5, stack.count - 1):
        picture, patch = stack.values(image, number), stack.patch(number)
        assert picture.shape == stack.size() == (patch.rows.stop, patch.columns.stop)
        index = np.stack(np.broadcast_arrays(*patch.places), axis=-1)
        assert (
            np.abs(index - np.rint(index)).max() < 1e-9
            and (np.rint(index[..., stack.axis]) == number).all()
        )
        z, y, x = np.moveaxis(np.rint(index).astype(int), -1, 0)
        assert (image[z, y, x] == picture).all()
        # hung as one hangs them: right, up and across are the nearest world directions
        way = geometry.index_to_world(index[-1, -1]) - geometry.index_to_world(index[0, 0])
        assert all(sign * way[axis] > 0 for axis, sign in HANGS[plane][:2])


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_a_place_is_origin_and_unit_vectors_in_mm(geometry, plane):
    index = np.random.default_rng(0).uniform(-3, 20, (9, 3))
    for stack in (SliceStack.along_voxels(geometry, plane), SliceStack.straight(geometry, plane)):
        place = stack.to_place(index)
        np.testing.assert_allclose(
            stack.origin + place @ stack.frame.T, geometry.index_to_world(index), atol=1e-9
        )
        np.testing.assert_allclose(stack.to_index(place), index, atol=1e-9)
        np.testing.assert_allclose(stack.frame.T @ stack.frame, np.eye(3), atol=1e-12)


def test_along_voxels_of_a_parallel_grid_places_are_the_world():
    geometry = Geometry((13, 22, 17), (2.4, 0.8, 1.1), (31.0, -12.0, 7.5), DIRECTIONS["flipped"])
    index = np.random.default_rng(1).uniform(0, 13, (9, 3))
    world = geometry.index_to_world(index)
    for plane in range(3):
        for stack in (
            SliceStack.along_voxels(geometry, plane),
            SliceStack.straight(geometry, plane),
        ):
            place = stack.to_place(index)
            np.testing.assert_allclose(
                world_of(plane, place[..., :2], place[..., 2]), world, atol=1e-9
            )


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_a_straight_pixel_has_the_place_and_the_value_that_the_world_says(geometry, plane):
    stack, image = SliceStack.straight(geometry, plane), image_of(geometry)
    last = np.array(geometry.shape) - 1.0
    seen = 0
    for number in range(0, stack.count, 3):
        places = pixels_of(stack)
        world = world_of(plane, places, stack.across(number))
        index = geometry.world_to_index(world)
        np.testing.assert_allclose(
            np.stack(np.broadcast_arrays(*stack.patch(number).places), -1), index, atol=1e-9
        )
        inside = ((index >= 0) & (index <= last)).all(axis=-1)
        np.testing.assert_allclose(
            stack.values(image, number)[inside], values_of(world[inside]), rtol=1e-5, atol=1e-3
        )
        seen += inside.sum()
    assert seen > 500


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_without_smoothing_a_pixel_is_the_nearest_voxel(geometry, plane):
    stack = SliceStack.straight(geometry, plane)
    names = np.arange(np.prod(geometry.shape)).reshape(geometry.shape)
    number = stack.count // 2
    index = geometry.world_to_index(world_of(plane, pixels_of(stack, FINE), stack.across(number)))
    inside = ((index > -0.5) & (index < np.array(geometry.shape) - 0.5)).all(axis=-1)
    z, y, x = np.moveaxis(np.rint(index[inside]).astype(int), -1, 0)
    picture = stack.values(names, number, smooth=False)
    assert (
        picture.dtype == names.dtype
        and (picture[inside] == names[z, y, x]).all()
        and inside.sum() > 300
    )


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_the_outline_is_where_the_image_ends(geometry, plane):
    """A pixel is in the polygon where its place lies in a voxel; pixels at the rim itself are left out."""
    stack = SliceStack.straight(geometry, plane)
    for number in (0, 2, stack.count // 2, stack.count - 1):
        corners = stack.outline(stack.across(number), (0, 0, 0), np.array(geometry.shape) - 1)
        assert len(corners) >= 3
        sides = np.roll(corners, -1, axis=0) - corners
        places = pixels_of(stack, 2)
        off = places[..., None, :] - corners
        away = (sides[:, 0] * off[..., 1] - sides[:, 1] * off[..., 0]) / np.linalg.norm(
            sides, axis=1
        )
        index = geometry.world_to_index(world_of(plane, places, stack.across(number)))
        inside = ((index >= -0.5) & (index <= np.array(geometry.shape) - 0.5)).all(axis=-1)
        clear = np.abs(away).min(axis=-1) > 1e-6
        assert (inside == (away > 0).all(axis=-1))[clear].all() and inside.any()
        left, right, bottom, top = stack.extent
        assert (corners.min(axis=0) >= [left - 1e-6, bottom - 1e-6]).all()
        assert (corners.max(axis=0) <= [right + 1e-6, top + 1e-6]).all()


@pytest.mark.sampled
@pytest.mark.parametrize("plane", [0, 1, 2])
@pytest.mark.parametrize("start", [(6.0, 10.5, 8.0), (0.0, 0.0, 0.0), (12.0, 0.0, 16.0)])
def test_each_slice_can_be_gone_to_and_the_cursor_stays_in_the_image(geometry, plane, start):
    for stack in (SliceStack.along_voxels(geometry, plane), SliceStack.straight(geometry, plane)):
        for number in (*range(stack.count), -3, stack.count + 5):
            index = stack.go_to(np.array(start), number)
            assert stack.nearest_number(index) == np.clip(number, 0, stack.count - 1)
            assert ((index >= 0) & (index <= np.array(geometry.shape) - 1)).all()
        straight_on = stack.go_to(
            np.array([6.0, 10.5, 8.0]), stack.nearest_number(np.array([6.0, 10.5, 8.0]))
        )
        np.testing.assert_allclose(
            stack.to_place(straight_on)[:2], stack.to_place([6.0, 10.5, 8.0])[:2], atol=1e-9
        )


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_a_patch_has_all_pixels_of_a_box(geometry, plane):
    low, high = np.array([3, 5, 4]), np.array([8, 12, 9])
    for stack in (SliceStack.along_voxels(geometry, plane), SliceStack.straight(geometry, plane)):
        cut = 0
        for number in range(stack.count):
            whole, patch = (
                np.stack(np.broadcast_arrays(*one.places), axis=-1)
                for one in (stack.patch(number, fine=2), stack.patch(number, low, high, fine=2))
            )
            inside = ((whole > low - 0.499) & (whole < high + 0.499)).all(axis=-1)
            at = stack.patch(number, low, high, fine=2)
            np.testing.assert_allclose(whole[at.rows, at.columns], patch, atol=1e-9)
            assert inside.sum() == inside[at.rows, at.columns].sum()
            assert stack.cuts(number, low, high) or not inside.any()
            assert stack.cuts(number, low, high) == (
                len(stack.outline(stack.across(number), low, high)) > 0
            )
            cut += bool(inside.any())
        assert cut >= 4


def test_times_that_never_came_are_as_late_as_the_latest_wanted():
    times = np.full((3, 3, 3), np.inf, np.float32)
    times[1] = 1.0
    at = (np.array([1.0, 1.25, 2.0]), np.array([1.0, 1.0, 0.0]), np.array([1.0, 1.5, 0.3]))
    np.testing.assert_allclose(linear(times, at, largest=5.0), [1.0, 2.0, 5.0])
    one = np.arange(6.0).reshape(1, 2, 3)
    assert linear(one, (np.array([0.4]), np.array([0.5]), np.array([1.5]))).tolist() == [3.0]
