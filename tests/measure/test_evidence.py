"""Evidence along a surface, and the place where it is least."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.measure.evidence import deepest_voxel, gather_evidence, uncertain_places

SHAPE, SPACING = (36, 44, 48), (1.5, 1.0, 0.8)


def coordinates():
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(SHAPE, SPACING, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


def noise(amount=0.05):
    return np.random.default_rng(1).normal(0, amount, SHAPE)


def ball(radius=10.0):
    z, y, x = coordinates()
    return np.sqrt(z**2 + y**2 + x**2) < radius


def look(mask, image, clicked=None):
    found = gather_evidence(mask, image.astype(np.float32), SPACING, clicked)
    assert found is not None
    return found


def test_evidence_is_high_on_an_edge_and_low_within_a_tissue():
    image = ball() + noise()
    right, wrong = look(ball(), image), look(ball(6.0), image)
    assert right.total.mean() > 0.9 and right.inside_like < 0.02 and right.contrast > 8
    assert wrong.total.mean() < 0.3 and wrong.inside_like > 0.9 and wrong.contrast < 2


@pytest.mark.parametrize(("scale", "shift"), [(1000.0, -300.0), (-1.0, 0.0)])
def test_it_depends_neither_on_the_unit_nor_on_what_else_is_in_the_image(scale, shift):
    image = ball() + noise()
    other = scale * image + shift
    other[0, 0, 0] = 1e6  # metal
    one, two = look(ball(), image), look(ball(), other)
    assert two.contrast == pytest.approx(one.contrast, rel=1e-3)
    np.testing.assert_allclose(two.total, one.total, atol=1e-3)


def test_contrast_counts_in_noise():
    weak, strong = (look(ball(), ball() + noise(amount)).contrast for amount in (0.3, 0.1))
    assert strong == pytest.approx(3 * weak, rel=0.25)


def test_a_click_is_evidence_near_it_only():
    clicked = np.zeros(SHAPE, bool)
    clicked[18, 22, 18:20] = True  # beside the surface of the small ball, to the left
    image = ball() + noise()
    found = look(ball(6.0), image, clicked)
    left = found.index[:, 2] < 20
    assert found.click[left].mean() > 2 * found.click[~left].mean()
    assert np.all(look(ball(6.0), image).click == 0)


def test_the_doubtful_place_is_where_it_leaked():
    z, y, x = coordinates()
    image = ball(9.0) + noise()
    leaked = ball(9.0) | (
        (np.abs(y) < 4) & (np.abs(z) < 4) & (x > 0) & (x < 16)
    )  # into nothing, to the right
    place, share = uncertain_places(look(leaked, image), SPACING, leaked.sum() * 1.2)[0]
    assert x[place] > 8 and share > 0.5
    _, little = uncertain_places(look(ball(9.0), image), SPACING, 3000.0)[0]
    assert little < 0.2


def test_several_uncertain_places_lie_apart_and_the_first_is_the_most_uncertain():
    z, y, x = coordinates()
    image = ball(9.0) + noise()
    near = (
        (np.abs(y) < 4) & (np.abs(z) < 4) & (np.abs(x) < 18)
    )  # into nothing, to the right and farther to the left
    leaked = ball(9.0) | (near & (x < 14))
    found = uncertain_places(look(leaked, image), SPACING, leaked.sum() * 1.2, 4)
    assert found[0] == uncertain_places(look(leaked, image), SPACING, leaked.sum() * 1.2)[0]
    assert x[found[0][0]] < -8 and x[found[1][0]] > 8 and min(found[0][1], found[1][1]) > 0.4
    places = np.array([place for place, _ in found]) * SPACING
    apart = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(len(found), 1)]
    assert len(found) > 1 and apart.min() > 5.0


def test_values_that_change_from_the_middle_outwards_are_a_drift():
    z, y, x = coordinates()
    r = np.sqrt(z**2 + y**2 + x**2)
    two = 1.0 * (r < 12) + 0.5 * (r < 7) + noise()
    assert look(r < 12, two).drift > 1.5 > 0.5 > look(r < 12, (r < 12) + noise()).drift


def test_nothing_and_one_slice():
    assert gather_evidence(np.zeros(SHAPE, bool), noise().astype(np.float32), SPACING) is None
    y, x = np.indices((40, 44)) - 20.0
    disc = (x**2 + y**2 < 12**2)[np.newaxis]
    found = gather_evidence(disc, disc.astype(np.float32), (5.0, 1.0, 1.0))
    assert found is not None and found.total.mean() > 0.8 and np.all(found.index[:, 0] == 0)


def test_the_deepest_voxel_is_the_first_of_those_farthest_from_the_surface():
    draw = np.random.default_rng(6)
    for shape, spacing, share in (
        ((15, 22, 17), (2.0, 1.0, 0.5), 0.4),
        ((1, 30, 31), (5.0, 1.0, 1.0), 0.6),
    ):
        inside = ndimage.gaussian_filter(draw.normal(size=shape), 2.0) > 0.05 * share
        away = ndimage.distance_transform_edt(inside, sampling=spacing)
        assert deepest_voxel(inside, spacing) == np.unravel_index(away.argmax(), shape)
