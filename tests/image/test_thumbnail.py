"""Thumbnails: the middle slice, oriented and with square pixels, and outlines of labels."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from accelsurf.grid.geometry import Geometry
from accelsurf.image.thumbnail import OUTLINE, SIZE, as_html, data_uri
from accelsurf.image.volume import Volume


def pixels(uri):
    head, data = uri.split(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_pixels_are_square_and_the_longer_edge_has_the_size():
    geometry = Geometry((3, 10, 20), (5.0, 1.0, 0.25))
    assert pixels(data_uri(np.zeros((3, 10, 20)), geometry)).shape == (SIZE, SIZE // 2, 3)


def test_the_axial_slice_has_the_front_at_the_top_and_the_left_at_the_right():
    image = np.zeros((1, 4, 4))
    image[0, 0, 3] = 1  # front left of the patient: y runs to the back, x to the left (LPS)
    got = pixels(data_uri(image, Geometry(image.shape, (1.0, 1.0, 1.0))))
    assert got[0, -1].min() == 255 and got[-1, 0].max() == 0
    turned = Geometry(image.shape, (1.0, 1.0, 1.0), direction=np.diag([-1.0, -1.0, 1.0]))
    got = pixels(data_uri(image, turned))
    assert got[-1, 0].min() == 255 and got[0, -1].max() == 0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_image_of_one_slice_shows_that_slice(axis):
    shape = [6, 6, 6]
    shape[axis] = 1
    image = np.random.default_rng(axis).random(shape)
    got = pixels(data_uri(image, Geometry(tuple(shape), (1.0, 1.0, 1.0))))
    assert got.shape == (SIZE, SIZE, 3) and len(np.unique(got)) > 20


def test_labels_choose_the_slice_and_have_an_outline():
    labels = np.zeros((9, 16, 16), np.uint8)
    labels[7:, 4:12, 4:12] = 1  # not in the middle slice
    got = pixels(data_uri(np.ones(labels.shape), Geometry(labels.shape, (1.0, 1.0, 1.0)), labels))
    outline = (got == OUTLINE).all(axis=2)
    assert outline.sum() == 28 * (SIZE // 16) ** 2  # of 8 x 8 voxels those at the rim
    assert not outline[SIZE // 2, SIZE // 2]


@pytest.mark.parametrize("value", [np.nan, np.inf, 5.0])
def test_any_value_makes_a_picture(value):
    image = np.full((2, 3, 4), value)
    image[0, 0, 0] = 1.0
    assert pixels(data_uri(image, Geometry(image.shape, (1.0, 1.0, 1.0)))).shape[2] == 3


def test_html_has_the_picture_and_the_escaped_text():
    volume = Volume.from_array(np.zeros((4, 5), bool))
    made = as_html("a < b", volume.array, volume.geometry)
    assert "a &lt; b" in made and made.startswith('<img src="data:image/png;base64,')
    assert repr(volume.geometry) in volume._repr_html_()
