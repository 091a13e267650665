"""Energies of a run in a window that knows the whole image have the bytes of those on the whole image."""

import numpy as np
import pytest

from accelsurf.errors import UsageError
from accelsurf.grid.boxes import box_at
from accelsurf.grid.pyramid import levels, restrict
from accelsurf.image.filters import ImageFilters
from accelsurf.image.volume import Volume
from accelsurf.io.lazy_volume import LazyVolume
from accelsurf.large.whole_image import WholeImage
from accelsurf.levelset import LevelSet
from accelsurf.run.energy import make_energy
from accelsurf.run.image_context import ImageContext
from accelsurf.run.preprocessing import apply_filters, filtered_volume, scale_of
from accelsurf.settings.run_config import RunConfig

SHAPE, SPACING, SIGMA = (44, 60, 64), (1.2, 1.0, 0.9), 0.8
#: A corner and a size that the blocks of two levels fit.
CORNER, WINDOW = (4, 6, 8), (34, 44, 48)
TERMS = [
    "chan-vese",
    "likelihood",
    "likelihood:update=no",
    "likelihood:model=histogram",
    "likelihood:model=histogram,update=no",
    "threshold:auto,",
    "threshold:20%,97%",
    "threshold:learned,",
    "chan-vese:channel=2 + 0.5*likelihood:channel=1",
]


def scans():
    rng = np.random.default_rng(2)
    z, y, x = np.indices(SHAPE)
    ball = np.sqrt((1.2 * (z - 21)) ** 2 + (y - 27.5) ** 2 + (0.9 * (x - 31)) ** 2) - 9.0
    one, other = np.where(ball < 0, 90, 30) + 0.4 * x, 5 * np.cos(ball)
    images = [one + rng.normal(0, 12, SHAPE), other + rng.normal(0, 1, SHAPE)]
    return [Volume.from_array(image.astype(np.float32), SPACING) for image in images], ball.astype(
        np.float32
    )


def on_level(array, level, shape):
    grids = levels(shape, SPACING, 2)
    for fine, coarse in zip(grids[:level], grids[1:], strict=False):
        array = restrict(array, fine, coarse)
    return array, grids[level].spacing


def evolved(text, images, psi, scales, level, whole=(), background=None):
    """Value and force of an energy while its surface moves, and the settings that it had; with psi."""
    context = ImageContext(
        images, scales, SPACING, psi < -2, background, is_start=True, whole=whole
    )
    parts = [on_level(image, level, psi.shape)[0] for image in images]
    psi, spacing = on_level(psi, level, psi.shape)
    made = make_energy(RunConfig(energy=text), parts[0], spacing, context.with_channels(parts[1:]))
    surface = LevelSet(psi, spacing)
    made.energy.start(surface)
    found = []
    for _ in range(3):
        fraction, area = surface.fraction_and_area()
        front = surface.front()
        found.append(made.energy.value(surface, fraction, area))
        force = made.energy.force(surface, front, surface.curvature(front))
        found.append(force.tobytes())
        surface.advance((0.4 * np.sign(force)).astype(np.float32), 1.0)
        made.energy.follow(surface, surface.redistance())
    return found, made.terms, surface.psi


@pytest.mark.sampled(6)
@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("text", TERMS)
def test_a_window_has_the_bytes_of_the_whole(text, level):
    volumes, psi = scans()
    box = box_at(CORNER, WINDOW)
    smooth = [filtered_volume(one, ImageFilters(sigma=SIGMA)) for one in volumes]
    scales = [scale_of(one) for one in smooth]
    images = [apply_filters(*both) for both in zip(smooth, scales, strict=True)]
    want, terms, surface = evolved(text, images, psi, scales, level)
    filters, slab = ImageFilters(sigma=SIGMA), 4 * 60 * 64 * 7
    whole = [WholeImage(LazyVolume.of_array(one), filters, slab_bytes=slab) for one in volumes]
    windows = [apply_filters(one.window(box), one.scale) for one in whole]
    got, own_terms, part = evolved(
        text, windows, psi[box].copy(), [one.scale for one in whole], level, whole
    )
    assert got == want and own_terms == terms
    halved = tuple(slice(s.start >> level, s.stop >> level) for s in box)
    assert surface[halved].tobytes() == part.tobytes()
    alone, _, _ = evolved(text, windows, psi[box].copy(), [one.scale for one in whole], level)
    assert alone != want or "learned" in text, "of the window alone it would be another"


def test_the_least_variance_is_that_of_the_whole():
    """Both sides are even: the range of the whole image alone says how sharp their distributions are."""
    psi, box = scans()[1], box_at(CORNER, WINDOW)
    values = np.where(psi < 0, 50.0, 20.0).astype(np.float32)
    values[0, 0, :30] = 5000.0
    volume = Volume.from_array(values, SPACING)
    whole = [WholeImage(LazyVolume.of_array(volume))]
    want, _, _ = evolved(
        "likelihood", [apply_filters(volume.as_float32(), whole[0].scale)], psi, [whole[0].scale], 0
    )
    windows = [apply_filters(whole[0].window(box), whole[0].scale)]
    assert evolved("likelihood", windows, psi[box].copy(), [whole[0].scale], 0, whole)[0] == want


def test_given_background_is_learned_from_as_it_is():
    volumes, psi = scans()
    image = apply_filters(volumes[0].as_float32(), scale_of(volumes[0].as_float32()))
    background = np.zeros(SHAPE, np.bool_)
    background[30:, 40:, :7] = True
    context = ImageContext([image], [scale_of(image)], SPACING, psi < -2, background)
    made = make_energy(RunConfig(energy="likelihood:update=no"), image, SPACING, context)
    models = made.terms[0]
    low, width = scale_of(image)
    sample = image[background].astype(np.float64)
    assert models["outside"]["mean"] == pytest.approx(low + width * sample.mean(), rel=1e-9)
    assert models["outside"]["deviation"] == pytest.approx(width * sample.std(), rel=1e-9)
    rest = ImageContext([image], [scale_of(image)], SPACING, psi < -2)
    other = make_energy(RunConfig(energy="likelihood:update=no"), image, SPACING, rest).terms[0][
        "outside"
    ]
    assert other["mean"] == pytest.approx(
        low + width * image[psi >= -2].mean(dtype=np.float64), rel=1e-9
    )
    with pytest.raises(UsageError, match="nothing to learn from"):
        bare = ImageContext([image], [scale_of(image)], SPACING)
        make_energy(RunConfig(energy="likelihood:update=no"), image, SPACING, bare)
