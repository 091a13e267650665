"""The first click: the size is asked over voxels, and beyond a bound over blocks; the same size, much sooner."""

from functools import partial

import numpy as np
import pytest

from accelsurf.energies.seeded import appearance, first_click, seeded_model
from accelsurf.energies.seeded import blocks as blocks_module
from accelsurf.energies.seeded.appearance import even_radius, learn
from accelsurf.energies.seeded.contest import WALKS_REACH, box_around
from accelsurf.energies.seeded.proposal import LevelEvidence, joined
from accelsurf.grid.boxes import box_at, widened
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import GUARD, LeavesWindow, Window
from tests.energies.seeded.test_seeded_model import dice
from tests.support import clicked_balls

SHAPE, SPACING = (40, 80, 84), (1.5, 1.0, 1.0)
ball = partial(clicked_balls.ball, shape=SHAPE, spacing=SPACING)
distance = partial(clicked_balls.distance, shape=SHAPE, spacing=SPACING)


@pytest.fixture
def short(monkeypatch):
    """Marches are long after some thousand voxels."""
    monkeypatch.setattr(blocks_module, "MAX_BLOCKS", 1000)
    monkeypatch.setattr(first_click, "MAX_BLOCKS", 1000)
    monkeypatch.setattr(first_click, "MAX_MARCH", 3151)


@pytest.fixture
def marches(monkeypatch):
    """The bound of each march of a first click."""
    bounds = []
    march = first_click.arrival

    def noted(field, tissue, seeds, bound):
        bounds.append(bound)
        return march(field, tissue, seeds, bound)

    monkeypatch.setattr(first_click, "arrival", noted)
    return bounds


def image_of(*radii):
    """Shells around one middle in noise: bright within the first radius, half as bright within the second."""
    away = distance((20, 40, 42))
    made = np.random.default_rng(5).normal(0, 0.08, SHAPE)
    for number, radius in enumerate(radii, 1):
        made += (away < radius) / number
    return made.astype(np.float32), away


@pytest.mark.parametrize("radius", [5, 9, 15])
def test_blocks_find_the_object_that_voxels_find(short, marches, radius, monkeypatch):
    image, away = image_of(radius)
    click = Clicks((ball("inside", (20, 40, 42), 0.4 * radius),), SHAPE)
    found = seeded_model([image], SPACING, click)
    assert max(marches) <= 1.5 * 3151 and len(marches) > 1
    monkeypatch.undo()
    voxels = seeded_model([image], SPACING, click)
    assert found.proposal.volume_mm3 == pytest.approx(voxels.proposal.volume_mm3, rel=0.15)
    assert dice(found.start, away < radius) > dice(voxels.start, away < radius) - 0.02 > 0.9


def test_a_march_that_ends_by_itself_needs_no_blocks(short, marches):
    image, away = image_of(9)
    model = seeded_model([image], SPACING, Clicks((ball("inside", (20, 40, 42), 4.0),), SHAPE), mask=away < 8)
    assert len(marches) == 1 + (model.answer.blocks.size > 1)


def test_an_outside_click_makes_the_size_smaller_also_beyond_the_march_over_voxels(short):
    image, away = image_of(6, 18)
    clicks = ball("inside", (20, 40, 42), 2.0), ball("outside", (20, 40, 51), 1.0)
    found = seeded_model([image], SPACING, Clicks(clicks, SHAPE))
    assert not found.start[clicks[1].box][clicks[1].mask].any()
    assert found.start[clicks[0].box][clicks[0].mask].all() and dice(found.start, away < 6) > 0.85


def test_a_window_changes_no_byte_of_what_is_asked_over_blocks(short):
    shape = (40, 200, 200)
    near = partial(clicked_balls.distance, shape=shape, spacing=SPACING)
    image = (near((20, 100, 100)) < 11).astype(np.float32) + 0.2 * (near((20, 100, 100)) < 24)
    image = image.astype(np.float32)
    clicks = Clicks((clicked_balls.ball("inside", (20, 100, 100), 3.0, shape=shape, spacing=SPACING),), shape)
    whole = seeded_model([image], SPACING, clicks)
    box = box_at((0, 7, 5), (40, 186, 188))
    window = Window(Geometry(shape, SPACING[::-1]), box)
    part = seeded_model([image[box].copy()], SPACING, clicks.on_box(box), window=window)
    assert whole.answer.blocks.size > 1
    assert part.proposal == whole.proposal and part.field.tobytes() == whole.field[box].tobytes()


def test_a_window_that_cuts_what_the_contests_look_at_is_left():
    """Though what they show lies well within it: they end where all beyond is outside."""
    shape = (60, 120, 120)
    near = partial(clicked_balls.distance, shape=shape, spacing=SPACING)
    image = (near((30, 60, 60)) < 6).astype(np.float32)
    click = Clicks((clicked_balls.ball("inside", (30, 60, 60), 3.0, shape=shape, spacing=SPACING),), shape)
    whole = seeded_model([image], SPACING, click)
    walks = box_around(click, SPACING, WALKS_REACH, whole.answer.count)[0]
    for margin in (GUARD, GUARD - 1):
        box = widened(walks, shape, (margin, margin, margin))
        assert all(s.start > 0 and s.stop < n for s, n in zip(box[1:], shape[1:], strict=True))
        window, part = Window(Geometry(shape, SPACING[::-1]), box), [image[box].copy()]
        if margin == GUARD:
            inner = seeded_model(part, SPACING, click.on_box(box), window=window)
            assert inner.field.tobytes() == whole.field[box].tobytes()
        else:
            with pytest.raises(LeavesWindow):
                seeded_model(part, SPACING, click.on_box(box), window=window)


def test_evidence_over_blocks_goes_on_where_that_over_voxels_ends():
    counts = np.arange(100, 1001, 50)
    whole = np.sin(counts / 90.0)
    near = LevelEvidence(counts[counts <= 600], whole[counts <= 600].copy(), 800)
    near.score[near.counts > 400] = 99.0  # what comes next is not known there
    far = LevelEvidence(counts, whole - 0.7, 1200)
    found = joined(near, far)
    np.testing.assert_array_equal(found.counts, counts)
    np.testing.assert_allclose(found.score, whole, atol=1e-12)
    assert found.reached == 1200
    none = LevelEvidence(counts[:0], whole[:0], 50)
    assert joined(near, none) is near and joined(none, far).counts.tolist() == counts.tolist()


@pytest.mark.parametrize(("shape", "spacing"), [((30, 44, 46), (1.4, 1.0, 0.8)), ((1, 80, 80), (0.3, 1.0, 1.0))])
def test_the_even_tissue_is_that_of_one_look_at_all(shape, spacing, monkeypatch):
    middle = (shape[0] // 2, shape[1] // 2, shape[2] // 2)
    away = clicked_balls.distance(middle, shape=shape, spacing=spacing)
    noise = np.random.default_rng(2).normal(0, 0.1, shape)
    click = clicked_balls.ball("inside", middle, 1.5, shape=shape, spacing=spacing)
    for radius in (3.0, 6.0, 11.0, 16.0, 99.0):
        image = (5.0 * (away < radius) + noise).astype(np.float32)
        seen = [image], spacing, click, learn([image], spacing, click)
        found = even_radius(*seen)
        with monkeypatch.context() as patch:
            patch.setattr(appearance, "FIRST_LOOK", 1e9)
            assert even_radius(*seen) == found
        if 6.0 <= radius < 15.0:
            assert found == pytest.approx(radius, abs=1.5)


@pytest.fixture(scope="module")
def dim_in_large():
    """A ball hardly brighter than the large one that it is in, which is the even tissue around a click in it."""
    large, small = distance((20, 40, 42)) < 27, distance((20, 40, 42)) < 5
    image = 1.0 * large + 0.05 * small + np.random.default_rng(0).normal(0, 0.05, SHAPE)
    return image.astype(np.float32), small


@pytest.mark.slow
def test_an_outside_click_much_wider_than_the_inside_ones_disowns_the_even_tissue(dim_in_large):
    image, small = dim_in_large
    inside, wide = ball("inside", (20, 40, 42), 2.5), ball("outside", (20, 40, 63), 6.5)

    def made(*clicks, **kwargs):
        return seeded_model([image], SPACING, Clicks(clicks, SHAPE), **kwargs)

    first = made(inside)
    assert first.proposal.volume_mm3 > 10 * np.count_nonzero(small) * np.prod(SPACING)
    both = made(inside, wide)
    assert both.proposal.volume_mm3 < 0.2 * first.proposal.volume_mm3
    assert dice(both.start, small) > 5 * dice(first.start, small)
    # As wide as the object is no contradiction of it, nor a wide one elsewhere, nor after an inside click as wide.
    for others in (
        [ball("outside", (20, 40, 63), 3.0)],
        [ball("outside", (20, 8, 8), 7.0)],
        [ball("inside", (20, 24, 42), 5.0), wide],
    ):
        assert made(inside, *others).proposal.volume_mm3 == first.proposal.volume_mm3
    again = made(inside, wide, previous=first)
    assert again.field.tobytes() == both.field.tobytes()
    more = wide, ball("inside", (20, 42, 42), 1.5)
    assert made(inside, *more, previous=both).field.tobytes() == made(inside, *more).field.tobytes()
