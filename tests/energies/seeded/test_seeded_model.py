"""The seeded model: it finds plain objects, holds clicks, keeps what was right, and stays sensible on odd input."""

from functools import partial

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.energies.front_samples import sample_at_front
from accelsurf.energies.seeded import seeded_model
from accelsurf.errors import InputError
from accelsurf.grid.clicks import Clicks
from accelsurf.run.energy import make_energy
from accelsurf.run.image_context import ImageContext, ModelInputs, Scale
from accelsurf.settings.run_config import RunConfig
from tests.support import clicked_balls, gradient_check
from tests.support.gradient_check import assert_derivative

SPACING = (1.5, 1.0, 0.8)
SHAPE = (26, 40, 48)


distance = partial(clicked_balls.distance, shape=SHAPE, spacing=SPACING)
ball = partial(clicked_balls.ball, shape=SHAPE, spacing=SPACING)


def volume_of(mask, spacing=SPACING):
    return float(mask.sum() * np.prod(spacing))


def dice(one, other):
    return 2.0 * np.logical_and(one, other).sum() / (one.sum() + other.sum())


@pytest.fixture(scope="module")
def two_balls():
    """Two balls of one brightness, joined by a thin neck, in noise: (image, the first ball)."""
    one, other = distance((13, 20, 14)) < 8, distance((13, 20, 36)) < 8
    neck = np.zeros(SHAPE, bool)
    neck[12:15, 19:22, 20:32] = True
    noise = np.random.default_rng(1).normal(0, 0.15, SHAPE)
    return ((one | other | neck) + noise).astype(np.float32), one


def test_one_click_finds_a_ball_without_a_size():
    inside = distance((13, 20, 24)) < 9
    image = (inside + np.random.default_rng(0).normal(0, 0.2, SHAPE)).astype(np.float32)
    model = seeded_model([image], SPACING, Clicks((ball("inside", (13, 20, 24), 4.5),), SHAPE))
    assert dice(model.start, inside) > 0.93
    assert model.proposal.volume_mm3 == pytest.approx(volume_of(inside), rel=0.2)
    assert 0.0 <= model.proposal.sureness <= 1.0


def test_a_size_that_is_wrong_by_a_quarter_is_a_prior(two_balls):
    image, one = two_balls
    clicks = Clicks((ball("inside", (13, 20, 14), 4.0),), SHAPE)
    for factor in (0.8, 1.25):
        model = seeded_model([image], SPACING, clicks, size_mm3=factor * volume_of(one))
        assert dice(model.start, one) > 0.85


def test_an_outside_click_takes_away_its_piece_alone(two_balls):
    image, one = two_balls
    first = ball("inside", (13, 20, 14), 4.0)
    wide = seeded_model([image], SPACING, Clicks((first,), SHAPE), size_mm3=2.1 * volume_of(one))
    both = seeded_model(
        [image], SPACING, Clicks((first, ball("outside", (13, 20, 36), 4.0)), SHAPE), size_mm3=2.1 * volume_of(one)
    )
    assert dice(wide.start, one) < 0.75
    assert dice(both.start, one) > 0.85
    assert not (both.answer.inside & ~wide.answer.inside).any()
    # The edges beside what it takes away are looked for anew, within a voxel.
    assert not (both.start & ~ndimage.binary_dilation(wide.start)).any()


@pytest.mark.parametrize("noise", [0.05, 0.15])
def test_of_two_equals_that_touch_an_outside_click_takes_one_whole(noise):
    """The other one looks as likely as the object: where the outside click is nearer, that says nothing for it."""
    centres = (13, 20, 12.75), (13, 20, 35.25)  # 18 mm apart
    one, other = (distance(at) for at in centres)
    objects = (one < 10) & (one <= other), (other < 10) & (other < one)
    image = ((objects[0] | objects[1]) + np.random.default_rng(0).normal(0, noise, SHAPE)).astype(np.float32)
    for own, against, truth in ((*centres, objects[0]), (*centres[::-1], objects[1])):
        clicks = Clicks((ball("inside", own, 3.0), ball("outside", against, 3.0)), SHAPE)
        assert dice(seeded_model([image], SPACING, clicks).start, truth) > 0.97


def test_an_inside_click_adds_and_takes_nothing_away(two_balls):
    image, one = two_balls
    first = ball("inside", (13, 20, 14), 4.0)
    small = seeded_model([image], SPACING, Clicks((first,), SHAPE), size_mm3=volume_of(one))
    both = seeded_model(
        [image], SPACING, Clicks((first, ball("inside", (13, 20, 36), 4.0)), SHAPE), size_mm3=volume_of(one)
    )
    assert both.start[distance((13, 20, 36)) < 6].all()
    assert not (small.start & ~both.start).any()


def test_clicked_voxels_are_on_their_side(two_balls):
    image, _ = two_balls
    clicks = Clicks(
        (ball("inside", (13, 20, 14), 3.0), ball("outside", (13, 20, 24), 1.0), ball("inside", (2, 3, 3), 0.5)), SHAPE
    )
    model = seeded_model([image], SPACING, clicks)
    np.testing.assert_array_equal(model.field[clicks.mask("inside")], -3.0)
    np.testing.assert_array_equal(model.field[clicks.mask("outside")], 3.0)
    assert model.start[clicks.mask("inside")].all()
    assert not model.start[clicks.mask("outside")].any()
    others = ~(clicks.mask("inside") | clicks.mask("outside"))
    assert np.abs(model.field[others]).max() < 3.0


def test_the_model_before_and_threads_change_nothing(two_balls):
    image, one = two_balls
    every = (ball("inside", (13, 20, 14), 4.0), ball("outside", (13, 20, 30), 1.5), ball("inside", (18, 20, 14), 1.0))
    kwargs = {"size_mm3": volume_of(one)}
    copy = image.copy()
    whole = seeded_model([image], SPACING, Clicks(every, SHAPE), **kwargs)
    threaded = seeded_model([image], SPACING, Clicks(every, SHAPE), threads=3, **kwargs)
    model = None
    for count in (1, 2, 3):
        model = seeded_model([image], SPACING, Clicks(every[:count], SHAPE), previous=model, **kwargs)
    for name in ("field", "start"):
        assert getattr(model, name).tobytes() == getattr(whole, name).tobytes() == getattr(threaded, name).tobytes()
    np.testing.assert_array_equal(image, copy)


def test_the_unit_of_spacing_does_not_matter(two_balls):
    image, one = two_balls
    clicks = Clicks((ball("inside", (13, 20, 14), 4.0), ball("outside", (13, 20, 36), 3.0)), SHAPE)
    mm = seeded_model([image], SPACING, clicks, size_mm3=volume_of(one))
    finer = tuple(h / 1024 for h in SPACING)
    um = seeded_model([image], finer, clicks, size_mm3=volume_of(one, finer))
    np.testing.assert_array_equal(mm.start, um.start)
    np.testing.assert_allclose(um.answer.times_in, mm.answer.times_in / 1024, rtol=1e-5)


def test_values_may_have_any_scale(two_balls):
    image, one = two_balls
    clicks = Clicks((ball("inside", (13, 20, 14), 4.0),), SHAPE)
    plain = seeded_model([image], SPACING, clicks, size_mm3=volume_of(one)).start
    scaled = seeded_model([image * 1000 - 500], SPACING, clicks, size_mm3=volume_of(one)).start
    assert dice(plain, scaled) > 0.99


def test_a_box_and_a_mask_bound_it(two_balls):
    image, one = two_balls
    clicks = Clicks((ball("inside", (13, 20, 14), 4.0),), SHAPE)
    box = (slice(4, 23), slice(8, 33), slice(3, 27))
    boxed = seeded_model([image], SPACING, clicks, box=box)
    beyond = np.ones(SHAPE, bool)
    beyond[box] = False
    assert not boxed.start[beyond].any()
    assert dice(boxed.start, one) > 0.9
    masked = seeded_model([image], SPACING, clicks, size_mm3=volume_of(one), mask=~beyond)
    assert not masked.start[beyond].any()
    with pytest.raises(InputError, match="outside the box"):
        seeded_model([image], SPACING, clicks, box=(slice(0, 5), slice(0, 5), slice(0, 5)))


def test_a_second_channel_tells_what_the_first_cannot():
    noise = np.random.default_rng(2).normal(0, 0.2, (2, *SHAPE))
    inside = distance((13, 20, 24)) < 9
    half = np.indices(SHAPE)[2] < 24
    images = [(inside + noise[0]).astype(np.float32), (half + noise[1]).astype(np.float32)]
    clicks = Clicks((ball("inside", (13, 20, 18), 2.5),), SHAPE)
    size = volume_of(inside & half)
    alone = seeded_model(images[:1], SPACING, clicks, size_mm3=size)
    both = seeded_model(images, SPACING, clicks, size_mm3=size)
    assert dice(both.start, inside & half) > max(0.9, dice(alone.start, inside & half))


def test_a_single_slice():
    shape, spacing = (1, 64, 64), (5.0, 0.5, 0.5)
    inside = distance((0, 32, 32), shape=shape, spacing=spacing) < 8
    image = (inside + np.random.default_rng(0).normal(0, 0.2, shape)).astype(np.float32)
    click = ball("inside", (0, 32, 32), 4.0, shape=shape, spacing=spacing)
    model = seeded_model([image], spacing, Clicks((click,), shape))
    assert dice(model.start, inside) > 0.87


def test_a_stone_in_the_click_does_not_blow_it_up(two_balls):
    image, one = two_balls
    clicks = Clicks((ball("inside", (13, 20, 14), 4.0),), SHAPE)
    stone = image.copy()
    stone[12:14, 19:22, 13:15] = 60.0
    model = seeded_model([stone], SPACING, clicks, size_mm3=volume_of(one))
    assert dice(model.start, one) > 0.85


@pytest.mark.parametrize("kind", ["constant", "noise", "border", "one voxel"])
def test_odd_input_gives_a_finite_field(kind):
    image = np.random.default_rng(0).normal(0, 1, SHAPE).astype(np.float32)
    if kind == "constant":
        image[:] = 4.0
    click = (
        ball("inside", (0, 0, 0), 3.0)
        if kind == "border"
        else ball("inside", (13, 20, 24), 0.4 if kind == "one voxel" else 4.0)
    )
    later = ball("outside", (20, 30, 40), 0.4)
    model = seeded_model([image], SPACING, Clicks((click, later), SHAPE))
    assert np.isfinite(model.field).all()
    assert model.start[click.box][click.mask].all()
    assert np.isfinite(model.proposal.volume_mm3)


def test_without_an_inside_click_it_says_so():
    with pytest.raises(InputError, match="no inside click"):
        seeded_model([np.zeros(SHAPE, np.float32)], SPACING, Clicks((ball("outside", (5, 5, 5), 2.0),), SHAPE))


def term_of(grid):
    """An energy as a run has it: of two channels, within a mask, with a weight, an area of its own, and three clicks.

    And its context. The surface that is perturbed touches the click outside, one of those inside, and the mask.
    """
    shape, spacing = gradient_check.GRIDS[grid]
    z, y, x = gradient_check.coordinates(grid)
    r, middle = np.sqrt(z**2 + y**2 + x**2), np.array([(n - 1) / 2 for n in shape])
    smooth = [1.5 / h if n > 1 else 0.0 for n, h in zip(shape, spacing, strict=True)]
    noise = 0.05 * np.random.default_rng(0).normal(size=shape)
    images = [ndimage.gaussian_filter(one, smooth).astype(np.float32) for one in ((r < 13) + noise, (r < 15) | (x > 0))]
    places = (("inside", (0, 0, 0), 5.0), ("outside", (0, 0, 15), 2.0), ("inside", (0, -12, 0), 1.5))
    clicks = tuple(
        ball(side, middle + np.array(at) / spacing, radius, shape=shape, spacing=spacing) for side, at, radius in places
    )
    context = ImageContext(images, [Scale(), Scale()], spacing).with_clicks(Clicks(clicks, shape))
    context = context.with_model_inputs(ModelInputs(mask=x > -12))
    config = RunConfig(energy="0.7*seeded:area=0.4", smoothness=0.3)
    return make_energy(config, images[0], spacing, context), context


@pytest.mark.parametrize(("grid", "tolerance"), [("3D", 0.02), ("thick slices", 0.05), ("one slice", 0.02)])
def test_the_force_is_the_derivative_of_the_energy(grid, tolerance):
    """F has steps at its clicks and bends at edges, which a grid sees the less well the thicker its slices are."""
    made, context = term_of(grid)
    for seed in (1, 3):
        assert_derivative(made.energy, grid, seed, 1e-2, tolerance)
    # It is F of the model, lowered by the offset, and the weight counts for F and area alike.
    (term,), model = made.terms, context.seeded_model()
    (used,) = term["channels"]
    assert 0 < used["offset"] < 0.2 and made.energy.alpha == pytest.approx(0.7 * 0.4 + 0.3)
    surface = gradient_check.value(made.energy, np.sqrt((gradient_check.coordinates(grid) ** 2).sum(0)) - 9, grid)[1]
    front = np.ones(surface.size, bool)
    force = made.energy.force(surface, front, np.zeros(surface.size, np.float32))
    field = sample_at_front(model.field.ravel() - np.float32(used["offset"]), surface, front)
    np.testing.assert_allclose(force, 0.7 * field, atol=1e-5)
