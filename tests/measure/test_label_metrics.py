"""Agreement label by label: the numbers of each label alone on the whole grid, whatever box it is cropped to."""

import dataclasses
import math
import tracemalloc

import numpy as np
import pytest

from accelsurf.errors import GeometryError, InputError
from accelsurf.image.volume import Volume
from accelsurf.measure.label_metrics import (
    LabelMap,
    evaluate_labels,
    evaluate_object,
    label_boxes,
    over_cases,
)
from accelsurf.measure.metrics import evaluate, surface_dice

H = (2.5, 1.0, 0.5)


def selected(array, ids=(), spacing=H):
    return LabelMap(Volume.from_array(array, spacing), ids)


@pytest.fixture
def maps():
    """Two maps of ragged labels, some at the border, one of one slice in a volume, one in one map alone."""
    rng = np.random.default_rng(5)
    a, b = np.zeros((2, 16, 20, 24), np.int32)
    for label, (z, y, x) in {1: (0, 0, 0), 2: (9, 8, 7), 70_000: (3, 12, 15)}.items():
        for shift, one in ((0, a), (1, b)):
            part = one[z : z + 6, y + shift : y + 7 + shift, x : x + 8]
            part[rng.random(part.shape) < 0.8] = label
    a[15, 3:8, 12:18], b[15, 4:8, 12:18] = 5, 5
    a[12:14, 0:3, 20:24] = 9
    return a, b


def test_each_label_has_the_numbers_of_that_label_alone(maps):
    a, b = maps
    found = evaluate_labels(selected(a), selected(b), (), (0.5, 1.0))
    assert [one.label for one in found] == [1, 2, 5, 9, 70_000]
    for one in found:
        masks = a == one.label, b == one.label
        alone = evaluate(*(Volume.from_array(mask.astype(np.uint8), H) for mask in masks))
        assert dataclasses.astuple(one.metrics) == pytest.approx(
            dataclasses.astuple(alone), rel=1e-12, nan_ok=True
        )
        expected = surface_dice(*masks, H, [0.5, 1.0])
        assert list(one.surface_dice.values()) == pytest.approx(expected, rel=1e-12)
        assert one.in_pred == (one.label,) and one.in_ref == (
            () if one.label == 9 else (one.label,)
        )


def test_a_label_of_one_slice_in_a_volume_is_no_2d_image(maps):
    # All its voxels have a neighbour outside; the outline alone is the border of a 2D image.
    five = next(one for one in evaluate_labels(*map(selected, maps)) if one.label == 5)
    assert five.metrics.mean_surface_distance_mm == pytest.approx(6 / (30 + 24))


def test_the_whole_and_chosen_ids(maps):
    a, b = maps
    whole = evaluate_object(selected(a), selected(b))
    assert whole.metrics == evaluate(Volume.from_array(a, H), Volume.from_array(b, H))
    assert whole.in_pred == (1, 2, 5, 9, 70_000) and whole.label is None
    some = evaluate_object(selected(a, ((2, 5),)), selected(b, ((1, 1), (60_000, 80_000))))
    masks = (a == 2) | (a == 5), (b == 1) | (b == 70_000)
    alone = evaluate(*(Volume.from_array(mask.astype(np.uint8), H) for mask in masks))
    assert some.metrics.dice == alone.dice and some.metrics.hausdorff_mm == pytest.approx(
        alone.hausdorff_mm
    )
    assert (
        evaluate_object(selected(a, ((0, 1),)), selected(b, ((0, 1),))).metrics.volume_pred_mm3
        == (a == 1).sum() * 1.25
    )


def test_labels_that_are_asked_for(maps):
    a, b = maps
    found = evaluate_labels(selected(a), selected(b), ((2, 9), (3, 3), (11, 20), (0, 0)), (1.0,))
    assert [one.label for one in found] == [2, 3, 5, 9]
    three, nine = found[1], found[3]
    assert all(
        math.isnan(three.values()[name] or math.nan) for name in ("dice", "iou", "surface_dice_1mm")
    )
    assert nine.values()["dice"] == nine.values()["iou"] == nine.values()["surface_dice_1mm"] == 0.0
    assert (
        nine.values()["hd95_mm"] is None
        and nine.values()["volume_difference_ml"] == 24 * 1.25 / 1000
    )
    assert [
        one.label for one in evaluate_labels(selected(a, ((2, 2),)), selected(b, ((5, 5),)))
    ] == [
        2,
        5,
    ]


def test_boxes_of_labels_of_any_size():
    rng = np.random.default_rng(1)
    labels = rng.integers(0, 7, (40, 300, 300)).astype(np.uint8) * (
        rng.random((40, 300, 300)) < 1e-4
    )
    small = label_boxes(labels)
    assert set(small) == set(np.unique(labels)) - {0}
    for label, box in small.items():
        places = np.argwhere(labels == label)
        assert [(one.start, one.stop) for one in box] == list(
            zip(places.min(0), places.max(0) + 1, strict=True)
        )
    large = label_boxes(labels.astype(np.int64) * 1_000_000_007)
    assert large == {label * 1_000_000_007: box for label, box in small.items()}
    assert (
        label_boxes(np.array([[[-1, 0]]])) == {}
        and label_boxes(np.zeros((0, 3, 3), np.uint8)) == {}
    )
    assert label_boxes(np.array([[[True]]])) == {1: (slice(0, 1),) * 3}
    with pytest.raises(InputError, match="float32"):
        label_boxes(np.ones((1, 1, 1), np.float32))


def test_memory_is_that_of_boxes_not_of_the_volume():
    a, b = np.zeros((2, 96, 256, 256), np.uint8)
    a[40:50, 100:110, 100:110], b[40:50, 101:111, 100:110] = 3, 3
    sides = selected(a), selected(b)
    tracemalloc.start()
    evaluate_labels(*sides, (), (1.0,))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < a.size / 2


def test_other_grids_are_refused(maps):
    a, b = maps
    for call in (evaluate_labels, evaluate_object):
        with pytest.raises(GeometryError, match="spacing"):
            call(selected(a), selected(b, spacing=(2.5, 1.0, 0.6)))


def test_means_leave_out_what_is_not_defined():
    found = over_cases(
        [
            {"dice": 1.0, "hd": 4.0},
            {"dice": 0.0, "hd": None},
            {"dice": 0.5, "hd": 6.0},
            {"dice": None},
        ]
    )
    assert found["mean"] == {"dice": 0.5, "hd": 5.0} and found["count"] == {"dice": 3, "hd": 2}
    assert over_cases([{"dice": 0.0}, {"dice": 0.1}, {"dice": 1.0}])["median"] == {"dice": 0.1}
    assert over_cases([{"hd": None}]) == {
        "mean": {"hd": None},
        "median": {"hd": None},
        "count": {"hd": 0},
    }
