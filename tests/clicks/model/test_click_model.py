"""The model of clicks: obeyed at once, click by click as at once, elsewhere as it was; sizes, masks, slices, parts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.clicks.model import ClickModel, Scene, click_model
from accelsurf.clicks.model.confidence import confidence_of
from accelsurf.clicks.model.features import features_of_first, features_of_later
from accelsurf.clicks.model.model import first_blocks, without_cut_off
from accelsurf.clicks.model.windows import SCALES, seed_of, window_around
from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import LeavesWindow, Window
from tests.support import clicked_balls

SHAPE, SPACING = (24, 44, 46), (2.0, 1.0, 1.0)


def click(side, middle, radius=0.0, shape=SHAPE, spacing=SPACING):
    return clicked_balls.ball(side, middle, radius, shape, spacing)


def clicks(*given, shape=SHAPE):
    return Clicks(given, shape)


def ball(middle, radius, shape=SHAPE, spacing=SPACING):
    return clicked_balls.distance(middle, shape, spacing) <= radius


@pytest.fixture(scope="module")
def two_balls():
    """A bright ball, and another with a narrow bridge to it, in noise."""
    truth = ball((12, 16, 14), 9.0)
    other = ball((12, 32, 32), 8.0)
    bridge = ball((12, 24, 23), 5.0)
    image = (truth | other | bridge) + np.random.default_rng(5).normal(0.0, 0.15, SHAPE)
    return Scene((image.astype(np.float32),), SPACING), truth, other


FIRST = click("inside", (12, 16, 14), 4.5)


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def shown(model, shape=SHAPE):
    return model.inside_on(whole_box(shape))


def test_one_click_finds_a_ball_to_the_voxel():
    truth = ball((12, 20, 22), 10.0)
    for noise, least in ((0.0, 0.995), (0.3, 0.95)):
        image = truth + np.random.default_rng(2).normal(0.0, noise, SHAPE)
        model = click_model(
            Scene((image.astype(np.float32),), SPACING), clicks(click("inside", (12, 20, 22), 5.0))
        )
        assert dice(shown(model), truth) >= least
        assert np.array_equal(model.inside, model.field < 0)


def test_clicks_are_on_their_sides_and_an_outside_one_takes_a_part_off(two_balls):
    scene, truth, other = two_balls
    first = click_model(scene, clicks(FIRST))
    far = click("outside", (12, 32, 32), 4.0)
    both = click_model(scene, clicks(FIRST, far), previous=first)
    assert not shown(both)[far.box][far.mask].any() and shown(both)[FIRST.box][FIRST.mask].all()
    assert not (shown(both) & ~shown(first)).any()
    assert dice(shown(both), truth) >= dice(shown(first), truth) - 0.02
    again = click_model(
        scene, clicks(FIRST, far, click("inside", (12, 32, 32), 4.0)), previous=both
    )
    assert (
        not (shown(both) & ~shown(again)).any() and (shown(again) & other).sum() > 0.5 * other.sum()
    )


def test_what_an_outside_click_cuts_off_goes_with_it(two_balls):
    scene, truth, other = two_balls
    bridge = click("outside", (12, 24, 23), 4.0)
    seen = np.zeros(SHAPE, bool)
    seen[bridge.box] = bridge.mask
    tip, box = other & ~seen, whole_box(SHAPE)
    whole = truth | seen | tip
    field = np.where(whole, -0.5, 0.5).astype(np.float32)
    given = replace(click_model(scene, clicks(FIRST)), box=box, field=field, inside=whole)
    after = click_model(scene, clicks(FIRST, bridge), previous=given)
    assert not shown(after)[seen | tip].any() and shown(after)[truth & ~seen].mean() > 0.6
    more = click("inside", (12, 32, 32), 2.0)
    assert shown(click_model(scene, clicks(FIRST, more, bridge)))[tip].any()  # it is clicked


@pytest.mark.parametrize(("length", "stays"), [(6, False), (9, False), (10, True), (20, True)])
def test_a_piece_that_is_more_than_what_remains_is_not_cut_off(length, stays):
    shape = (1, 1, 32)
    row = np.zeros(shape, bool)
    row[..., 1 : 11 + length] = True
    inside = Click("inside", (slice(0, 1), slice(0, 1), slice(2, 4)), np.ones((1, 1, 2), bool))
    outside = Click("outside", (slice(0, 1), slice(0, 1), slice(10, 11)), np.ones((1, 1, 1), bool))
    before = ClickModel(
        clicks(inside, shape=shape), whole_box(shape), np.where(row, -1, 1).astype(np.float32), row
    )
    now = row.copy()
    now[..., 10] = False
    now[..., 30] = True  # was never in one piece with the click
    after = replace(
        before, clicks=clicks(inside, outside, shape=shape), field=np.where(now, -1, 1), inside=now
    )
    found = without_cut_off(after, before).inside
    assert found[..., 11 : 11 + length].all() == found[..., 11 : 11 + length].any() == stays
    assert found[..., 1:10].all() and found[..., 30].all()


def test_click_by_click_and_at_once_are_the_same_bytes(two_balls):
    scene = two_balls[0]
    later = (
        click("outside", (12, 24, 23), 2.0),
        click("inside", (8, 14, 13), 1.5),
        click("outside", (3, 16, 14), 2.0),
    )
    given = [FIRST, *later]
    model = None
    for count in range(1, len(given) + 1):
        model = click_model(scene, clicks(*given[:count]), previous=model)
        whole = click_model(scene, clicks(*given[:count]))
        assert model.box == whole.box and model.field.tobytes() == whole.field.tobytes()
        assert model.correction == whole.correction and model.answers == whole.answers
    # The first inside click is read first, wherever it stands.
    moved = click_model(scene, clicks(given[1], given[0], *given[2:]))
    assert moved.field.tobytes() == model.field.tobytes()


def test_a_click_on_its_side_already_changes_its_voxels_alone(two_balls):
    scene = two_balls[0]
    first = click_model(scene, clicks(FIRST))
    same = click_model(scene, clicks(FIRST, click("inside", (12, 15, 13), 2.0)), previous=first)
    assert np.array_equal(shown(same), shown(first)) and same.correction is None
    beyond = click_model(scene, clicks(FIRST, click("outside", (1, 1, 1))), previous=first)
    assert np.array_equal(shown(beyond), shown(first))


def test_no_inside_click_is_refused(two_balls):
    with pytest.raises(InputError, match="no inside click"):
        click_model(two_balls[0], clicks(click("outside", (1, 1, 1))))


def test_the_object_lies_where_it_may(two_balls):
    scene, truth, _ = two_balls
    may = np.zeros(SHAPE, bool)
    may[:, :20] = True
    model = click_model(scene._replace(open=may), clicks(FIRST))
    assert shown(model)[may].any() and np.count_nonzero(shown(model) & ~may) <= 0.05 * model.count


def test_a_size_is_met_and_another_answer_is_a_part(two_balls):
    scene, truth, _ = two_balls
    voxel = float(np.prod(SPACING))
    for part in (0.5, 1.0, 2.0):
        size = part * truth.sum() * voxel
        model = click_model(scene, clicks(FIRST), size_mm3=size)
        assert model.count * voxel == pytest.approx(size, rel=0.3)
        levels = first_blocks(scene, seed_of(FIRST, scene), size).levels
        assert levels.of_volume(size).level == model.answers[0].level
    usual = click_model(scene, clicks(FIRST))
    assert [answer.number for answer in usual.answers] in ([1, 3], [1, 2, 3])
    for answer in usual.answers[1:-1]:
        assert answer.volume_mm3 <= usual.answers[0].volume_mm3 / 1.5
        part = click_model(scene, clicks(FIRST), answer=2)
        assert part.answers[0] == answer and part.count < usual.count


@pytest.mark.parametrize("radius", [1.0, 2.5])
@pytest.mark.parametrize("part", [0.5, 0.7, 0.9])
def test_a_size_that_is_too_small_makes_no_holes(part, radius):
    truth = ball((24, 28, 28), 18.0, (48, 56, 56), (1.0, 1.0, 1.0))
    noise = np.random.default_rng(4).normal(0.0, 0.1, truth.shape)
    scene = Scene(
        ((ndimage.gaussian_filter(truth.astype(float), 0.5) + noise).astype(np.float32),),
        (1.0, 1.0, 1.0),
    )
    given = clicks(
        click("inside", (24, 28, 28), radius, truth.shape, (1.0, 1.0, 1.0)), shape=truth.shape
    )
    model = click_model(scene, given, size_mm3=part * truth.sum())
    assert np.array_equal(ndimage.binary_fill_holes(model.inside), model.inside)


def test_the_unit_of_values_and_of_lengths_does_not_matter(two_balls):
    scene, _, _ = two_balls
    usual = shown(click_model(scene, clicks(FIRST)))
    values = (7.0 * scene.images[0] + 100.0).astype(np.float32)
    other = Scene((values,), (6.0, 3.0, 3.0))
    assert dice(shown(click_model(other, clicks(FIRST))), usual) > 0.98


def test_features_mean_the_same_in_other_units(two_balls):
    scene, truth, _ = two_balls
    other = Scene(((5.0 * scene.images[0] + 70.0).astype(np.float32),), (6.0, 3.0, 3.0))
    outside = click("outside", (12, 24, 23), 2.0)

    def features(scene):
        seeds = [seed_of(given, scene) for given in (FIRST, outside)]
        later = window_around(scene, seeds, SCALES[1])
        found, _ = features_of_later(later, truth[later.box], 2, int(truth.sum()))
        first = features_of_first(window_around(scene, seeds[:1], SCALES[1]))
        return first | {f"later {name}": values for name, values in found.items()}

    usual, changed = features(scene), features(other)
    assert sorted(usual) == sorted(changed)
    for name, wanted in usual.items():
        different = np.abs(np.asarray(wanted, float) - changed[name]) > 1e-2 * (
            1.0 + np.abs(wanted)
        )
        assert np.mean(different) < 0.02, name  # ties of an order may fall elsewhere


def test_mirrored_images_have_mirrored_objects(two_balls):
    scene, _, _ = two_balls
    usual = shown(click_model(scene, clicks(FIRST)))
    flipped = Scene((np.ascontiguousarray(scene.images[0][:, ::-1]),), SPACING)
    seen = shown(click_model(flipped, clicks(click("inside", (12, SHAPE[1] - 17, 14), 4.5))))
    assert dice(seen[:, ::-1], usual) > 0.95  # blocks begin elsewhere


def test_in_one_slice():
    shape, spacing = (1, 60, 70), (5.0, 0.5, 0.5)
    truth = ball((0, 30, 35), 9.0, shape, spacing)
    image = (truth + np.random.default_rng(3).normal(0.0, 0.2, shape)).astype(np.float32)
    scene = Scene((image,), spacing)
    model = click_model(
        scene, clicks(click("inside", (0, 30, 35), 4.5, shape, spacing), shape=shape)
    )
    assert dice(shown(model, shape), truth) > 0.95
    off = click("outside", (0, 30, 50), 1.0, shape, spacing)
    less = click_model(scene, Clicks((*model.clicks.clicks, off), shape), previous=model)
    assert not shown(less, shape)[0, 30, 50]


def test_clicks_of_other_objects_keep_theirs(two_balls):
    """As one object sees them: inside clicks of others are outside, and count where it would take them."""
    scene, truth, other = two_balls
    theirs = click("inside", (12, 32, 32), 4.0)._replace(id=2)
    both = clicks(FIRST, theirs)
    mine, second = (click_model(scene, both.of(number)) for number in (1, 2))
    assert (
        not shown(mine)[theirs.box][theirs.mask].any()
        and not shown(second)[FIRST.box][FIRST.mask].any()
    )
    assert dice(shown(mine), truth) > 0.7 and dice(shown(second), other) > 0.7


def test_a_part_of_an_image_has_the_model_of_the_whole_or_asks_for_more():
    shape, spacing = (64, 120, 124), (1.0, 1.0, 1.0)
    truth = ball((32, 50, 52), 7.0, shape, spacing)
    image = (truth + np.random.default_rng(7).normal(0.0, 0.2, shape)).astype(np.float32)
    given = [
        click("inside", (32, 50, 52), 3.5, shape, spacing),
        click("outside", (32, 50, 60), 1.0, shape, spacing),
    ]
    whole = click_model(Scene((image,), spacing), Clicks(tuple(given), shape))
    geometry = Geometry(shape, spacing)
    for last in (110, 64):
        box = slice(0, 64), slice(0, last), slice(0, 124)
        scene = Scene((image[box],), spacing, None, Window(geometry, box))
        here = Clicks(tuple(given), scene.shape)
        if last == 64:
            with pytest.raises(LeavesWindow):
                click_model(scene, here)
        else:
            part = click_model(scene, here)
            assert part.box == whole.box and part.field.tobytes() == whole.field.tobytes()


def test_inputs_stay_as_they_are(two_balls):
    scene, _, _ = two_balls
    before = scene.images[0].copy()
    first = click_model(scene, clicks(FIRST))
    field = first.field.copy()
    click_model(scene, clicks(FIRST, click("outside", (12, 24, 23), 2.0)), previous=first)
    assert np.array_equal(scene.images[0], before) and np.array_equal(first.field, field)


def test_confidence_is_higher_of_a_clear_object(two_balls):
    clear = ball((12, 20, 22), 9.0).astype(np.float32)
    confident = confidence_of(
        click_model(Scene((clear,), SPACING), clicks(click("inside", (12, 20, 22), 4.5)))
    )
    noise = np.random.default_rng(0).normal(0.0, 1.0, SHAPE).astype(np.float32)
    hesitant = confidence_of(
        click_model(Scene((noise,), SPACING), clicks(click("inside", (12, 20, 22), 4.5)))
    )
    assert confident.overlap > hesitant.overlap and confident.spread < hesitant.spread
    assert confident.correction is None and 0.0 <= hesitant.overlap <= 1.0


def test_a_whole_image_may_be_the_click():
    image = np.zeros((4, 5, 6), np.float32)
    all_voxels = Click("inside", whole_box((4, 5, 6)), np.ones((4, 5, 6), bool))
    model = click_model(Scene((image,), SPACING), Clicks((all_voxels,), (4, 5, 6)))
    assert shown(model, (4, 5, 6)).all()


def test_what_an_outside_click_took_away_is_known(two_balls):
    scene = two_balls[0]
    first = click_model(scene, clicks(FIRST))
    cut = click_model(scene, clicks(FIRST, click("outside", (12, 16, 20), 4.0)), previous=first)
    share = 1 - cut.count / first.count
    assert cut.taken == pytest.approx(share, abs=0.02) and confidence_of(cut).taken == cut.taken
    added = click_model(
        scene,
        clicks(FIRST, click("outside", (12, 16, 20), 4.0), click("inside", (12, 16, 23), 1.0)),
    )
    assert added.taken == 0.0


def test_clicks_in_far_objects_cost_no_reading_and_change_nothing(two_balls, monkeypatch):
    scene = two_balls[0]
    first = click_model(scene, clicks(FIRST))
    far = [click("outside", (1, y, x))._replace(owner=2) for y in (1, 42) for x in (1, 44)]
    read = []
    monkeypatch.setattr(
        "accelsurf.clicks.model.model.seed_of", lambda *given: read.append(given) or seed_of(*given)
    )
    many = click_model(scene, clicks(FIRST, *far))
    assert many.field.tobytes() == first.field.tobytes() and len(read) == 1
