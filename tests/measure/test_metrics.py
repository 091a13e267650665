"""Metrics against hand-computed values, brute force and SimpleITK."""

import json
import math

import numpy as np
import pytest
import SimpleITK as sitk
from scipy.spatial.distance import cdist

from accelsurf.errors import GeometryError, InputError
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import border_points, dice, evaluate, surface_distances

SPACING = (2.0, 1.0, 1.0)  # (z, y, x): 1 x 1 x 2 mm


def blob(seed: int, shape: tuple[int, int, int] = (14, 17, 19)) -> np.ndarray:
    """A ragged object with cavities, off the border."""
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(shape)
    middle = np.array(shape) / 2 + rng.uniform(-1, 1, 3)
    r = np.sqrt(((z - middle[0]) * 1.3) ** 2 + (y - middle[1]) ** 2 + (x - middle[2]) ** 2)
    mask = r + rng.uniform(-1.5, 1.5, shape) < 5.5
    mask[[0, -1]] = mask[:, [0, -1]] = mask[:, :, [0, -1]] = False
    return mask


def compare(a: np.ndarray, b: np.ndarray, spacing: tuple[float, float, float] = SPACING):
    return evaluate(Volume.from_array(a, spacing), Volume.from_array(b, spacing))


def brute_border(mask: np.ndarray) -> np.ndarray:
    """Indices of object voxels with a face neighbour that is not object; the outside of the volume is not."""
    padded = np.pad(mask, 1)
    found = []
    for index in np.argwhere(mask):
        for axis in range(3):
            for step in (-1, 1):
                neighbour = index + 1
                neighbour[axis] += step
                if mask.shape[axis] > 1 and not padded[tuple(neighbour)]:
                    found.append(tuple(index))
    return np.array(sorted(set(found)))


@pytest.mark.parametrize("shape", [(6, 7, 8), (1, 7, 8), (6, 1, 8), (1, 1, 9), (2, 2, 2)])
def test_border_voxels_are_those_with_an_outside_face_neighbour(
    shape: tuple[int, int, int],
) -> None:
    mask = np.random.default_rng(3).random(shape) < 0.8
    np.testing.assert_array_equal(
        border_points(mask, SPACING), brute_border(mask) * np.array(SPACING)
    )


def test_border_of_a_view_and_of_a_non_contiguous_mask() -> None:
    mask = blob(1)
    expected = border_points(mask, SPACING)
    np.testing.assert_array_equal(border_points(np.asfortranarray(mask), SPACING), expected)
    assert len(expected) == len(brute_border(mask))


@pytest.mark.parametrize("seed", range(4))
def test_distances_equal_brute_force(seed: int) -> None:
    a, b = blob(seed), blob(seed + 100)
    pairs = cdist(brute_border(a) * np.array(SPACING), brute_border(b) * np.array(SPACING))
    from_a, from_b = pairs.min(axis=1), pairs.min(axis=0)
    got_a, got_b = surface_distances(a, b, SPACING)
    np.testing.assert_allclose(got_a, from_a, rtol=1e-12)
    np.testing.assert_allclose(got_b, from_b, rtol=1e-12)
    m = compare(a, b)
    assert m.hausdorff_mm == pytest.approx(max(from_a.max(), from_b.max()))
    assert m.hd95_mm == pytest.approx(max(np.percentile(from_a, 95), np.percentile(from_b, 95)))
    assert m.mean_surface_distance_mm == pytest.approx(np.concatenate([from_a, from_b]).mean())
    assert m.mean_surface_distance_mm < m.hd95_mm < m.hausdorff_mm


@pytest.mark.parametrize("shift", [(0, 0, 4), (0, 3, 0), (3, 0, 0), (2, -3, 1)])
@pytest.mark.parametrize("kind", ["ball", "box"])
def test_hausdorff_of_a_shifted_object_is_the_shift(kind: str, shift: tuple[int, int, int]) -> None:
    # For any set A the point farthest along v has no point of A within |v| once A is moved by v; and none is farther.
    z, y, x = np.indices((24, 40, 40))
    dz, dy, dx = 2.0 * (z - 12), y - 20.0, x - 20.0
    if kind == "ball":
        a = dz * dz + dy * dy + dx * dx < 11.3**2
    else:
        a = (np.abs(dz) < 9) & (np.abs(dy) < 7) & (np.abs(dx) < 11)
    b = np.roll(a, shift, (0, 1, 2))
    length = math.hypot(*(s * h for s, h in zip(shift, SPACING, strict=True)))
    m = compare(a, b)
    assert m.hausdorff_mm == pytest.approx(length, rel=1e-12)
    assert 0 < m.mean_surface_distance_mm < m.hd95_mm <= length
    assert m.volume_difference_mm3 == 0


def test_parallel_plates_by_hand() -> None:
    a, b = np.zeros((2, 9, 10, 10), dtype=np.uint8)
    a[2, :, :], b[5, :, :] = 1, 1
    m = compare(a, b)
    assert (m.hausdorff_mm, m.hd95_mm, m.mean_surface_distance_mm) == (6.0, 6.0, 6.0)
    assert (m.dice, m.iou) == (0.0, 0.0)
    # One voxel in a hundred far off moves the Hausdorff distance, not the 95th percentile.
    b[:] = a
    b[8, 0, 0] = 1
    m = compare(a, b)
    assert (m.hausdorff_mm, m.hd95_mm) == (12.0, 0.0)
    assert m.mean_surface_distance_mm == pytest.approx(12.0 / 201)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), SPACING])
def test_agrees_with_simpleitk(spacing: tuple[float, float, float]) -> None:
    a, b = blob(7), blob(8)
    images = []
    for mask in (a, b):
        image = sitk.GetImageFromArray(mask.astype(np.uint8))
        image.SetSpacing(spacing[::-1])
        images.append(image)
    overlap = sitk.LabelOverlapMeasuresImageFilter()
    overlap.Execute(*images)
    # ITK measures between whole objects; given their borders it measures what is meant here.
    hausdorff = sitk.HausdorffDistanceImageFilter()
    hausdorff.Execute(*(sitk.LabelContour(image, False) for image in images))
    m = compare(a, b, spacing)
    assert m.dice == pytest.approx(overlap.GetDiceCoefficient())
    assert m.iou == pytest.approx(overlap.GetJaccardCoefficient())
    assert m.hausdorff_mm == pytest.approx(hausdorff.GetHausdorffDistance(), rel=1e-6)


def test_volumes_and_their_difference() -> None:
    a, b = np.zeros((2, 6, 6, 6), dtype=np.int16)
    a[1:3, 1:3, 1:3], b[1:3, 1:3, 1:5] = 3, 1  # labels > 0 are the object, whatever their number
    a[5, 5, 5] = -1  # and this one is not
    m = compare(a, b)
    assert (m.volume_pred_mm3, m.volume_ref_mm3) == (16.0, 32.0)
    assert (m.volume_difference_mm3, m.volume_difference_percent) == (-16.0, -50.0)
    assert (m.dice, m.iou) == (pytest.approx(2 / 3), 0.5)


def test_swapping_the_maps_changes_only_the_sign_of_the_volume_difference() -> None:
    a, b = blob(11), blob(12)
    one, two = compare(a, b), compare(b, a)
    for name in ("dice", "iou", "hausdorff_mm", "hd95_mm"):
        assert getattr(one, name) == getattr(two, name)
    assert one.mean_surface_distance_mm == pytest.approx(two.mean_surface_distance_mm, rel=1e-12)
    assert one.volume_difference_mm3 == -two.volume_difference_mm3 != 0


def test_axis_order_and_flips_do_not_matter() -> None:
    a, b = blob(21), blob(22)
    straight = compare(a, b)
    turned = compare(
        a.transpose(2, 0, 1)[::-1], b.transpose(2, 0, 1)[::-1], (SPACING[2], SPACING[0], SPACING[1])
    )
    for name, value in straight.to_dict().items():
        assert turned.to_dict()[name] == pytest.approx(value, rel=1e-12), name


def test_identical_maps() -> None:
    m = compare(blob(5), blob(5))
    assert (m.dice, m.iou, m.hausdorff_mm, m.hd95_mm, m.mean_surface_distance_mm) == (1, 1, 0, 0, 0)


def test_both_empty_is_undefined() -> None:
    empty = np.zeros((4, 4, 4), dtype=np.uint8)
    m = compare(empty, empty)
    for name in (
        "dice",
        "iou",
        "volume_difference_percent",
        "hausdorff_mm",
        "hd95_mm",
        "mean_surface_distance_mm",
    ):
        assert math.isnan(getattr(m, name)), name
        assert m.to_dict()[name] is None
    assert (m.volume_pred_mm3, m.volume_ref_mm3, m.volume_difference_mm3) == (0, 0, 0)
    assert math.isnan(dice(empty, empty))


def test_one_empty_has_no_overlap_and_no_distance() -> None:
    empty, full = np.zeros((4, 4, 4), dtype=np.uint8), np.ones((4, 4, 4), dtype=np.uint8)
    without_ref, without_pred = compare(full, empty), compare(empty, full)
    for m in (without_ref, without_pred):
        assert (m.dice, m.iou) == (0, 0)
        assert (
            math.isnan(m.hausdorff_mm)
            and math.isnan(m.hd95_mm)
            and math.isnan(m.mean_surface_distance_mm)
        )
    assert math.isnan(without_ref.volume_difference_percent)
    assert without_pred.volume_difference_percent == -100.0


def test_to_dict_is_json_with_all_names() -> None:
    text = json.dumps(compare(blob(1), blob(2)).to_dict(), allow_nan=False)
    assert set(json.loads(text)) == {
        "dice",
        "iou",
        "volume_pred_mm3",
        "volume_ref_mm3",
        "volume_difference_mm3",
        "volume_difference_percent",
        "hausdorff_mm",
        "hd95_mm",
        "mean_surface_distance_mm",
    }


def test_another_grid_is_refused_and_the_difference_named() -> None:
    a = np.ones((4, 4, 4), dtype=np.uint8)
    with pytest.raises(GeometryError, match="spacing"):
        evaluate(Volume.from_array(a, 1.0), Volume.from_array(a, (1.0, 1.0, 1.5)))
    with pytest.raises(GeometryError, match="size"):
        evaluate(Volume.from_array(a), Volume.from_array(a[1:]))
    with pytest.raises(GeometryError, match="origin"):
        evaluate(Volume.from_array(a), Volume.from_array(a, origin=(0, 0, 2)))


def test_nan_labels_and_other_shapes_are_refused() -> None:
    bad = np.ones((3, 3, 3))
    bad[1, 1, 1] = np.nan
    with pytest.raises(InputError, match="1 labels are NaN"):
        compare(bad, np.ones((3, 3, 3)))
    with pytest.raises(InputError, match="equal shapes"):
        dice(np.ones(3), np.ones(4))


def test_inputs_stay_as_they_are() -> None:
    a, b = blob(31), blob(32)
    before = a.copy(), b.copy()
    a.setflags(write=False)
    b.setflags(write=False)
    compare(a, b)
    np.testing.assert_array_equal(a, before[0])
    np.testing.assert_array_equal(b, before[1])
