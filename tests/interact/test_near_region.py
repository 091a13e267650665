"""What holds the surface during a correction, and how it is measured before."""

import dataclasses
import math

import numpy as np
import pytest

from accelsurf.grid.boxes import whole_box
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.interact.local_evolution import RELABEL_REACH, relabel, restore_psi
from accelsurf.interact.refiner import Refiner
from accelsurf.interact.region import NearRegion, near_bounds, united
from accelsurf.levelset import LevelSet
from accelsurf.settings.corrections import Correction
from tests.interact.test_refine import first_run, two_balls, world

SHAPE, SPACING = (20, 24, 50), (1.0, 1.0, 1.0)


def distance_from(centre, shape=SHAPE):
    return np.sqrt(
        sum((i - c) ** 2 for i, c in zip(np.indices(shape), centre, strict=True))
    ).astype(np.float32)


def bounds_for(sides):
    """A ball of radius 6 on the left, a region of radius 12 about a place on the right; bounds as whole arrays."""
    before = distance_from((10, 12, 9)) - 6
    mask = distance_from((10, 12, 34)) <= 12
    bounds = near_bounds(before, NearRegion(whole_box(SHAPE), mask, 6.0), SPACING, sides)
    low, high = np.full(SHAPE, -np.inf), np.full(SHAPE, np.inf)
    low.ravel()[bounds.cells], high.ravel()[bounds.cells] = bounds.low, bounds.high
    return before, mask, low, high


@pytest.mark.parametrize("sides", [("inside",), ("outside",), ("inside", "outside")])
def test_a_surface_may_arise_anywhere_in_the_region_as_a_distance(sides):
    before, mask, low, high = bounds_for(sides)
    new = np.minimum(before, distance_from((10, 12, 34)) - 5)  # a ball, far from the old one
    free = mask & (distance_from((10, 12, 34)) < 5.5)
    assert (low[mask & ~free] <= 0.5).all()
    if "inside" in sides:
        assert ((low <= new) & (new <= high)).all()
    else:
        assert (low[free] > 0).all()  # nothing may be gained


def test_the_surface_before_is_held_beyond_the_region():
    before, mask, low, high = bounds_for(("inside", "outside"))
    inside = before < 0
    beside = np.zeros(SHAPE, bool)
    for axis in range(3):
        for step in (-1, 1):
            beside |= inside != np.roll(inside, step, axis)
    held = beside & ~mask
    assert held.any()
    np.testing.assert_array_equal(low[held], before[held])
    np.testing.assert_array_equal(high[held], before[held])


def test_one_side_holds_the_other_s_voxels():
    before = distance_from((10, 12, 25)) - 6
    region = NearRegion(whole_box(SHAPE), np.ones(SHAPE, bool), 6.0)
    bounds = near_bounds(before, region, SPACING, ("inside",))
    high = np.full(SHAPE, np.inf)
    high.ravel()[bounds.cells] = bounds.high
    assert (high[before < 0] < 0).all()
    bounds = near_bounds(before, region, SPACING, ("outside",))
    low = np.full(SHAPE, -np.inf)
    low.ravel()[bounds.cells] = bounds.low
    assert (low[before >= 0] >= 0).all()


def test_bounds_are_united_cell_by_cell():
    def of(cells, low, high):
        return ClickBounds((1, 2, 4), np.array(cells), np.float32(low), np.float32(high))

    both = united(of([1, 3, 6], [-1, -1, 2], [1, 1, 3]), of([0, 3, 6], [-9, -0.5, -9], [-1, 9, -2]))
    assert both.cells.tolist() == [0, 1, 3, 6]
    assert both.low.tolist() == [-9, -1, -0.5, -2]
    assert both.high.tolist() == [-1, 1, 1, -2]


@pytest.mark.parametrize(
    "shape, spacing", [((24, 26, 22), (1.5, 1.0, 1.0)), ((1, 40, 40), (3.0, 1.0, 1.0))]
)
def test_a_known_distance_is_measured_without_solving_it_again(shape, spacing):
    middle = [(n - 1) / 2 for n in shape]
    psi = (
        np.sqrt(
            sum(
                ((i - c) * h) ** 2
                for i, c, h in zip(np.indices(shape), middle, spacing, strict=True)
            )
        )
        - 8.3
    )
    first = LevelSet(psi.astype(np.float32), spacing)
    again = LevelSet(np.ones(shape, np.float32), spacing)
    restore_psi(again, first.psi.copy())
    np.testing.assert_array_equal(again.band.cells, first.band.cells)
    assert again.inside_beyond_band == first.inside_beyond_band
    (share, area), (expected, expected_area) = again.fraction_and_area(), first.fraction_and_area()
    np.testing.assert_array_equal(share, expected)
    assert math.isclose(area.sum(), expected_area.sum(), rel_tol=2e-3)


def test_what_a_click_wins_is_on_its_side_with_distances_around():
    psi = np.full(SHAPE, 3.0, np.float32)
    basin = distance_from((10, 12, 25)) <= 4
    relabel(psi, basin, "inside", SPACING)
    np.testing.assert_array_equal(psi < 0, basin)
    assert psi[10, 12, 31] == pytest.approx(1.5)
    assert (psi[:, :, : 25 - 5 - int(RELABEL_REACH)] == 3.0).all()
    before = np.full(SHAPE, -3.0, np.float32)
    relabel(before, basin, "outside", SPACING)
    np.testing.assert_array_equal(before >= 0, basin)


def test_a_piece_won_far_from_the_surface_comes_to_rest_without_gaining_energy():
    image, _, other = two_balls()
    refiner = Refiner(first_run(image, "seeded"))
    before = len(refiner.surfaces[0].history)
    (change,) = refiner.apply(Correction(inside=(f"ball:{world(12, 14, 48)},3",)))
    after = refiner.surfaces[0].history[before - 1 :]
    assert change.stop.reason == "converged" and len(after) <= 40
    first = after[0].potential
    assert max(record.potential for record in after) <= first + 0.01 * abs(first)
    assert (refiner.surfaces[0].psi < 0)[other].mean() > 0.97


@pytest.mark.threads
def test_a_correction_has_the_same_bytes_with_any_number_of_threads():
    image, _, _ = two_balls()
    result, found = first_run(image, "seeded"), []
    for threads in (1, 3):
        refiner = Refiner(
            dataclasses.replace(result, config=result.config.replace(threads=threads))
        )
        refiner.apply(Correction(inside=(f"ball:{world(12, 14, 48)},3",)))
        refiner.apply(Correction(outside=(f"ball:{world(12, 14, 21)},1.5",)))
        found.append(refiner.surfaces[0].psi.tobytes())
    assert found[0] == found[1]
