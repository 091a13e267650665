"""How far a correction goes: no voxel beyond what is stated, before it is made and after."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.clicks.model.reach import (
    bounded_by_count,
    distances_from,
    least_reach,
    most_voxels,
    radius_of,
    reach_of,
    separate_part,
)
from accelsurf.errors import UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click
from accelsurf.image.volume import Volume
from accelsurf.interact.refine import beginning_with
from accelsurf.interact.refiner import Refiner
from accelsurf.settings.corrections import Correction

SCENES = {
    "even": ((28, 40, 64), (1.0, 1.0, 1.0)),
    "thick": ((14, 40, 64), (3.0, 1.0, 1.0)),
    "flat": ((1, 48, 64), (1.0, 0.8, 0.8)),
}


def scene(name, seed):
    """An image of tubes that touch, and a mask of a part of them; a random place inside and one outside of it."""
    shape, spacing = SCENES[name]
    random = np.random.default_rng(seed)
    truth = np.zeros(shape, bool)
    for _ in range(4):
        ends = random.uniform(0.15, 0.85, (2, 3)) * (np.array(shape) - 1)
        line = np.rint(np.linspace(*ends, 200)).astype(int)
        truth[tuple(line.T)] = True
    radius = 3.5
    truth = ndimage.distance_transform_edt(~truth, sampling=spacing) <= radius
    image = 100.0 * truth + random.normal(0.0, 10.0, shape)
    mask = truth.copy()
    mask[..., : shape[2] // 2] = False
    return Volume.from_array(image.astype(np.float32), spacing), truth, mask


def distance_to_ball(volume, index, radius):
    """Distance, mm, of each voxel from the voxels of a ball."""
    axes = np.ogrid[tuple(slice(0, n) for n in volume.geometry.shape)]
    squares = sum(
        ((axis - i) * h) ** 2
        for axis, i, h in zip(axes, index, volume.geometry.spacing, strict=True)
    )
    return ndimage.distance_transform_edt(squares > radius**2, sampling=volume.geometry.spacing)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("near", ["auto", 7.0])
@pytest.mark.parametrize("seed", range(3))
def test_no_voxel_moves_beyond_the_stated_reach(name, near, seed):
    volume, truth, mask = scene(name, seed)
    refiner, random = Refiner(beginning_with(volume, mask.astype(np.uint8), None)), None
    random = np.random.default_rng(seed)
    for side, where in (("inside", truth & ~mask), ("outside", mask), ("outside", truth)):
        index = random.choice(np.argwhere(where))
        x, y, z = (float(v) for v in volume.geometry.index_to_world(index))
        radius = float(random.uniform(1.0, 4.0))
        correction = Correction(**{side: (f"ball:{x!r},{y!r},{z!r},{radius!r}",)}, near=near)
        before = refiner.result().labels > 0
        shown = refiner.reach_of(correction)
        (change,) = refiner.apply(correction)
        moved = (refiner.result().labels > 0) != before
        far = distance_to_ball(volume, index, radius)
        assert moved.sum() == change.voxels
        if change.reach is None:
            assert not moved.any() and change.text == f"nothing changed: it is already {side}"
            continue
        assert far[moved].max(initial=0.0) <= change.reach.mm + 1e-4
        assert change.reach.mm <= shown + 1e-4
        assert change.reach.mm == near if near != "auto" else change.reach.mm >= 0.0
        assert change.moved_mm == pytest.approx(far[moved].max(initial=0.0), abs=1e-4)
        settings = refiner.result().resolved_settings
        assert settings["reach_mm"][-1] == change.reach.mm
        assert settings["moved_mm"][-1] == change.moved_mm
        if moved.any():
            assert f", up to {change.moved_mm:.3g} mm from the click" in change.text
            is_less = f"{change.moved_mm:.3g}" != f"{change.reach.mm:.3g}"
            assert (f" (reach {change.reach.mm:.3g} mm)" in change.text) == is_less


def test_what_was_not_done_is_named_and_near_does_it():
    z, y, x = np.indices((24, 24, 96))
    image = 100.0 * ((z - 12) ** 2 + (y - 12) ** 2 < 25) * (x > 4) * (x < 90)
    mask = (image > 50) & (x < 30)
    volume = Volume.from_array(image.astype(np.float32), 1.0)
    refiner = Refiner(beginning_with(volume, mask.astype(np.uint8), None))
    click = "ball:33,12,12,2"
    (bounded,) = refiner.apply(Correction(inside=(click,)))
    assert bounded.is_bounded and f"--near {bounded.near_for_all:g}" in bounded.text
    refiner.undo()
    (whole,) = refiner.apply(Correction(inside=(click,), near=bounded.near_for_all))
    assert whole.voxels > bounded.voxels and not whole.is_bounded
    assert "--near" not in whole.text
    gained = (refiner.result().labels > 0) & ~mask
    assert gained.sum() == whole.voxels > 0.9 * ((image > 50) & ~mask).sum()


def test_a_click_reaches_by_its_radius_and_its_depth_and_moves_a_share():
    shape, spacing = (30, 30, 30), (1.0, 1.0, 1.0)
    inside = np.zeros(shape, bool)
    inside[5:25, 5:25, 5:25] = True
    places = np.indices(shape)
    for radius in (0.0, 2.0, 4.0):
        mask = ((places - 15) ** 2).sum(axis=0) <= radius**2
        click = Click("outside", whole_box(shape), mask)
        reach = reach_of(click, lambda box: inside[box], shape, spacing)
        assert reach == max(8.0 * radius_of(click, shape, spacing), 4.0 * 10.0)  # it is 10 deep
        other = click._replace(side="inside")  # it is on its side: no depth
        assert reach_of(other, lambda box: inside[box], shape, spacing) == pytest.approx(
            max(12.0 * radius_of(click, shape, spacing), 4.0)
        )
    assert least_reach((5, 5, 5), (6.0, 1.0, 1.0)) == 6.0
    assert most_voxels("outside", 1.0, 2000, spacing, False) == 1000
    assert most_voxels("inside", 1.0, 2000, spacing, False) == 2000
    assert most_voxels("inside", 2.0, 10, spacing, False) == int(4 / 3 * np.pi * 12**3)
    assert most_voxels("outside", 2.0, 10, (9.0, 1.0, 1.0), True) == int(np.pi * 12**2)
    distances = np.float32([0, 1, 1, 2, 5, 5, 9])
    assert [bounded_by_count(distances, 7.0, most, 0.5) for most in (1, 4, 5, 6)] == [0.5, 2, 2, 7]


def test_an_outside_click_in_a_separate_part_reaches_to_its_end():
    row = np.zeros((1, 1, 40), bool)
    row[..., 2:20] = row[..., 24:36] = True
    held = np.zeros_like(row)
    held[..., 5] = True
    at = np.zeros_like(row)
    at[..., 25] = True
    click = Click("outside", whole_box(row.shape), at)
    part = separate_part(click, whole_box(row.shape), row, held)
    assert part is not None and part.sum() == 12
    assert distances_from(click, whole_box(row.shape), (1.0, 1.0, 1.0))[part].max() == 10
    held[..., 30] = True
    assert separate_part(click, whole_box(row.shape), row, held) is None
    main = click._replace(mask=np.roll(at, -20, axis=2))
    assert separate_part(main, whole_box(row.shape), row, np.zeros_like(row)) is None


def test_a_reach_is_asked_of_clicks_that_can_be_made():
    volume, _, mask = scene("even", 0)
    refiner = Refiner(beginning_with(volume, mask.astype(np.uint8), None))
    before = refiner.result()
    with pytest.raises(UsageError):
        refiner.reach_of(Correction(inside=("point:1,2,3",), object=7))
    assert refiner.result().config == before.config


@pytest.mark.parametrize("neck", [2, 3, 4])
@pytest.mark.parametrize("radius", [6, 9])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_click_in_the_middle_of_a_leak_takes_it_up_to_its_neck(neck, radius, axis):
    """A ball of the object's values joined to it by a neck, within the reach of the click in it."""
    z, y, x = np.indices((40, 44, 90))
    across, at = (z - 20) ** 2 + (y - 22) ** 2, 44 + radius
    body, leak = across + (x - 26) ** 2 < 14**2, across + (x - at) ** 2 < radius**2
    tube = (across <= (neck / 2) ** 2) & (x >= 38) & (x <= at)
    mask = body | leak | tube
    image = 100.0 * mask + np.random.default_rng(neck).normal(0.0, 8.0, mask.shape)
    body, leak, mask, image = (np.swapaxes(each, axis, 2) for each in (body, leak, mask, image))
    place = [20, 22, at]
    place[axis], place[2] = place[2], place[axis]
    volume = Volume.from_array(np.ascontiguousarray(image, np.float32), 1.0)
    refiner = Refiner(beginning_with(volume, np.ascontiguousarray(mask, np.uint8)))
    click = f"ball:{place[2]},{place[1]},{place[0]},3"
    (change,) = refiner.apply(Correction(outside=(click,)))
    after = refiner.result().labels > 0
    assert change.reach.mm >= radius and not (after & leak).any()
    assert (after & body).sum() >= 0.999 * body.sum()
