"""Clipped, closed, smoothed: identities, the order, boxes of the whole."""

import numpy as np
import pytest

from accelsurf.image.filters import NO_FILTERS, ImageFilters, closed_mm

SPACING = (2.0, 0.9, 1.1)


@pytest.fixture
def image():
    return np.random.default_rng(5).normal(size=(12, 25, 31)).astype(np.float32)


def test_no_filter_leaves_the_image(image):
    assert NO_FILTERS.change_nothing and NO_FILTERS.of_whole(image, SPACING) is image
    assert not ImageFilters(closing=1.0).change_nothing


def test_a_closing_only_fills_and_does_so_once(image):
    closed = closed_mm(image, SPACING, 3.0)
    assert (closed >= image).all() and (closed > image).any()
    np.testing.assert_array_equal(closed_mm(closed, SPACING, 3.0), closed)


@pytest.mark.parametrize("width", [4.0, 12.0])
def test_marrow_narrower_than_the_ball_is_filled(width):
    """A shell of 2 mm around marrow: filled if no ball of 3 mm fits into it, else left dark in the middle."""
    x = np.arange(-15.0, 15.5, 0.5)
    z, y, x = np.meshgrid(x[::4], x[::2], x, indexing="ij")
    away = np.sqrt(x**2 + y**2 + z**2)
    image = np.where(
        away < 0.5 * width, 50.0, np.where(away < 0.5 * width + 2.0, 400.0, 0.0)
    ).astype(np.float32)
    closed = closed_mm(image, (2.0, 1.0, 0.5), 3.0)
    assert (closed[away < 0.5 * width].min() == 400.0) == (width < 6.0)
    assert (
        closed[away > 0.5 * width + 2.0].max() == 0.0
    )  # a ball is convex: nothing is added around it


@pytest.mark.parametrize(
    "filters",
    [ImageFilters((-0.5, 1.2), 4.0, 1.3), ImageFilters(closing=3.0), ImageFilters((-np.inf, 0.3))],
)
def test_boxes_are_those_of_the_whole(image, filters):
    before = image.copy()
    whole = filters.of_whole(image, SPACING)
    for box in (
        (slice(4, 9), slice(3, 20), slice(10, 31)),
        (slice(0, 12), slice(0, 25), slice(0, 31)),
    ):
        got = filters.on_box(lambda part: image[part], image.shape, SPACING, box)
        np.testing.assert_array_equal(got, whole[box])
    np.testing.assert_array_equal(image, before)


def test_values_are_cut_before_the_closing():
    image = np.zeros((1, 1, 9), np.float32)
    image[0, 0, [2, 4]] = 1000.0
    out = ImageFilters((-np.inf, 250.0), 1.0).of_whole(image, (1.0, 1.0, 1.0))
    np.testing.assert_array_equal(out[0, 0], [0, 0, 250, 250, 250, 0, 0, 0, 0])
