"""Clicks on large objects, answered in blocks: the same object, the same bytes whichever way, conflicts held."""

from functools import partial

import numpy as np
import pytest

from accelsurf.correct.local_model import LocalModel, LocalState
from accelsurf.energies.seeded import blocks as module
from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.blocks import in_blocks
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from tests.energies.seeded.test_seeded_model import SHAPE, SPACING, ball, dice, distance, volume_of
from tests.support import clicked_balls

VOXEL = np.ones((1, 1, 1), bool)


@pytest.fixture
def few(monkeypatch):
    """Objects of more than some hundred voxels are large."""
    monkeypatch.setattr(module, "MAX_BLOCKS", 300)


@pytest.fixture(scope="module")
def scene():
    """Two balls of one brightness that touch, in noise: (image, the first ball, clicks that tell them apart)."""
    one, other = distance((13, 20, 14)) < 9, distance((13, 20, 36)) < 9
    image = ((one | other) + np.random.default_rng(1).normal(0, 0.15, SHAPE)).astype(np.float32)
    clicks = (
        ball("inside", (13, 20, 14), 4.0),
        ball("outside", (13, 20, 32), 1.5),
        ball("inside", (16, 20, 12), 1.0),
        ball("outside", (13, 20, 26), 1.0),
    )
    return image, one, clicks


def test_small_objects_have_blocks_of_one_voxel():
    image = np.zeros((4, 5, 6), np.float32)
    found = in_blocks([image], (1.0, 2.0, 3.0), None, None, module.MAX_BLOCKS)
    assert found.size == 1 and found.images[0] is image
    click = Click("inside", box_at((1, 1, 1), (1, 1, 1)), VOXEL)
    assert found.click(click, []) is click


def test_blocks_are_alike_to_all_sides_and_hold_the_bound():
    image = np.zeros((20, 60, 60), np.float32)
    found = in_blocks([image], (3.0, 1.0, 1.0), None, None, 30 * module.MAX_BLOCKS)
    assert found.steps[1] == found.steps[2] > found.steps[0] and 15 < found.size < 60
    assert max(found.spacing) / min(found.spacing) <= 1.5
    flat = in_blocks([image[:1]], (3.0, 1.0, 1.0), None, None, 9 * module.MAX_BLOCKS)
    assert flat.steps == (1, 3, 3)


@pytest.mark.usefixtures("few")
def test_later_clicks_find_the_object_that_they_find_voxel_by_voxel(scene, monkeypatch):
    image, one, clicks = scene
    given = {"size_mm3": volume_of(one)}
    coarse = seeded_model([image], SPACING, Clicks(clicks, SHAPE), **given)
    assert coarse.answer.blocks.size > 4
    monkeypatch.setattr(module, "MAX_BLOCKS", 100_000)
    fine = seeded_model([image], SPACING, Clicks(clicks, SHAPE), **given)
    assert fine.answer.blocks.size == 1
    assert dice(fine.start, one) > 0.97 and dice(coarse.start, one) > dice(fine.start, one) - 0.01
    for click in clicks:
        held = coarse.field[click.box][click.mask]
        assert np.all(held == (-3.0 if click.side == "inside" else 3.0))


@pytest.mark.usefixtures("few")
def test_threads_and_the_model_before_and_boxes_change_no_byte(scene):
    image, one, clicks = scene
    given = {"size_mm3": volume_of(one)}
    whole = seeded_model([image], SPACING, Clicks(clicks, SHAPE), **given)
    threaded = seeded_model([image], SPACING, Clicks(clicks, SHAPE), threads=3, **given)
    model = seeded_model([image], SPACING, Clicks(clicks[:1], SHAPE), **given)
    local = LocalModel(LocalState.of(model), [image], SPACING, None, lambda made: None, threads=2)
    for count in range(2, len(clicks) + 1):
        model = seeded_model([image], SPACING, Clicks(clicks[:count], SHAPE), previous=model, **given)
        local.add(clicks[count - 1])
        assert local.field_on(whole_box(SHAPE)).tobytes() == model.field.tobytes()
    assert whole.field.tobytes() == threaded.field.tobytes() == model.field.tobytes()
    assert np.array_equal(whole.start, model.start)


@pytest.mark.usefixtures("few")
def test_a_window_that_begins_within_a_block_changes_no_byte():
    shape = (26, 96, 110)
    near = partial(clicked_balls.distance, shape=shape, spacing=SPACING)
    made = partial(clicked_balls.ball, shape=shape, spacing=SPACING)
    image = (near((13, 47, 53)) < 7).astype(np.float32)
    clicks = Clicks((made("inside", (13, 47, 53), 2.5), made("outside", (13, 47, 64), 1.0)), shape)
    given = {"size_mm3": float((image > 0).sum() * np.prod(SPACING))}
    whole = seeded_model([image], SPACING, clicks, **given)
    steps = whole.answer.blocks.steps
    box = box_at((0, 3, 5), (26, 90, 100))
    assert whole.answer.blocks.size >= 4 and any(s.start % step for s, step in zip(box, steps, strict=True))
    window = Window(Geometry(shape, SPACING[::-1]), box)
    part = seeded_model([image[box].copy()], SPACING, clicks.on_box(box), window=window, **given)
    assert part.answer.blocks.missing != (0, 0, 0)
    assert part.field.tobytes() == whole.field[box].tobytes()


@pytest.mark.usefixtures("few")
def test_a_block_that_both_sides_click_is_of_the_earlier_click(scene):
    image, one, clicks = scene
    first = clicks[0]
    # The next voxel of the first click's face: it lies in a block of that click.
    edge = Click("outside", box_at((13, 20, int(first.box[2].stop)), (1, 1, 1)), VOXEL)
    model = seeded_model([image], SPACING, Clicks((first,), SHAPE), size_mm3=volume_of(one))
    blocks = model.answer.blocks
    own = blocks.click(first, [])
    inner = Click("outside", box_at((13, 20, 14), (1, 1, 1)), VOXEL)
    assert blocks.click(inner, [own]) is None and blocks.click(inner, []) is not None
    after = seeded_model([image], SPACING, Clicks((first, edge), SHAPE), previous=model, size_mm3=volume_of(one))
    assert after.field[13, 20, first.box[2].stop] == 3.0 and not after.start[13, 20, first.box[2].stop]
    assert after.start[first.box][first.mask].all()
    assert dice(after.start, one) > 0.9


@pytest.mark.usefixtures("few")
def test_what_a_mask_closes_stays_closed(scene):
    image, one, clicks = scene
    mask = np.zeros(SHAPE, bool)
    mask[:, :, :21] = True
    model = seeded_model([image], SPACING, Clicks(clicks[:3], SHAPE), mask=mask)
    assert not model.start[~mask].any() and dice(model.start, one & mask) > 0.9
