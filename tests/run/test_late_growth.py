"""Where the surface grew in the last part of its run."""

import numpy as np
import pytest

from accelsurf.api.segment import segment, segment_objects
from accelsurf.interact.refine import refine
from accelsurf.run.late_growth import BLOCK, nearest_inside


def dumbbell():
    """A ball with a long arm: the far end of the arm is reached last."""
    z, y, x = np.indices((28, 28, 64))
    ball = (x - 14) ** 2 + (y - 14) ** 2 + (z - 14) ** 2 < 9**2
    arm = ((y - 14) ** 2 + (z - 14) ** 2 < 4**2) & (x > 14) & (x < 56)
    return (100.0 * (ball | arm)).astype(np.float32)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("mask", "levels"), [(False, 1), (True, 1), (True, 2)])
def test_it_is_the_far_end_of_what_was_filled_last(mask, levels):
    image = dumbbell()
    region = np.zeros(image.shape, bool)
    region[3:, 4:, 2:] = True
    options = {"mask": region} if mask else {}
    result = segment(image, start="ball:14,14,14,5", levels=levels, smoothness=0.05, **options)
    assert "labels" not in vars(result.objects[0])  # they are made once the run's arrays are gone
    assert result.labels[14, 14, 54]  # it has got there
    z, y, x = result.late_leakage
    assert x > 40 and abs(y - 14) < 7 and abs(z - 14) < 7
    assert result.labels[
        int(z), int(y), int(x)
    ]  # a voxel of the object, through which a slice shows it


@pytest.mark.slow
def test_of_several_objects_it_is_where_any_grew_most():
    image = dumbbell()
    starts = np.zeros(image.shape, int)
    starts[11:18, 11:18, 11:18] = 4
    result = segment_objects(image, starts, levels=1, smoothness=0.05)
    assert result.late_leakage[2] > 40


def test_it_is_on_a_thin_object_too_and_goes_with_what_a_correction_takes_away():
    """The middle of a cube of six voxels lies beside a disk of three slices."""
    z, y, x = np.indices((24, 40, 40))
    disk = ((x - 20) ** 2 + (y - 20) ** 2 < 14**2) & (abs(z - 19) < 2)
    noise = np.random.default_rng(0).normal(0, 5, disk.shape)
    image = (100.0 * disk + noise).astype(np.float32)
    result = segment(
        image,
        inside="ball:20,20,19,1.5",
        start="ball:20,20,19,3",
        energy="threshold:50,",
        threads=1,
    )
    place = tuple(int(v) for v in result.late_leakage)
    assert result.labels[place]
    at = ",".join(str(v) for v in place[::-1])
    assert refine(result, inside="point:20,20,19").late_leakage == result.late_leakage
    assert refine(result, outside=f"ball:{at},4").late_leakage is None


@pytest.mark.parametrize("seed", range(4))
def test_nearest_inside_is_the_nearest_voxel_of_a_cube_around(seed):
    rng = np.random.default_rng(seed)
    labels = rng.random((9, 30, 40)) < 0.01
    place, spacing = tuple(rng.uniform(0, np.array(labels.shape) - 1)), (3.0, 1.0, 1.0)
    voxels = np.argwhere(labels)
    voxels = voxels[(np.abs(voxels - place) <= BLOCK).all(axis=1)]
    found = nearest_inside(place, labels.__getitem__, labels.shape, spacing)
    assert labels[tuple(int(at) for at in found)]
    least = np.linalg.norm((voxels - place) * spacing, axis=1).min()
    assert np.linalg.norm((np.array(found) - place) * spacing) <= least + 1e-9


def test_nearest_inside_of_an_object_that_has_left_the_place_is_none():
    labels = np.zeros((9, 40, 50), bool)
    labels[8, 2, 3] = True
    assert (
        nearest_inside((2.5, 20.0, 20.0), labels.__getitem__, labels.shape, (1.0, 1.0, 1.0)) is None
    )


def test_there_is_none_where_nothing_grew():
    image = dumbbell()
    assert segment(image, start="ball:14,14,14,5", max_steps=0).late_leakage is None
