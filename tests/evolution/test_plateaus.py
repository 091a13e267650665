"""Rests of a front: where it is found to rest, where it breaks through, and what going back to it gives."""

import numpy as np
import pytest

import accelsurf
from accelsurf.evolution.plateaus import MAX_FOUND, Moment, completed, fastest_place, watched
from accelsurf.evolution.records import StepFields
from accelsurf.evolution.state import PlateauWatch
from accelsurf.levelset import LevelSet, checkpoint_surface
from accelsurf.levelset.checkpoint import psi_of
from tests.support.records import step_record


def ball(shape=(24, 24, 24), radius=6.0):
    z, y, x = np.indices(shape) - 0.5 * (np.array(shape)[:, None, None, None] - 1)
    return LevelSet((np.sqrt(z**2 + y**2 + x**2) - radius).astype(np.float32), (1.0, 1.0, 1.0), 3.0)


def watch_over(volumes, level=0, **last):
    """The watch after a front of area 10 has had these volumes, a step of 1 each."""
    surface = ball()
    fields = StepFields(surface.band.cells, surface.band.psi, -np.ones(surface.size, np.float32))
    watch, records = PlateauWatch(), []
    for n, volume in enumerate(volumes):
        watch = completed(watch, level, surface)
        watch = watched(watch, records, Moment(n, level, volume, 10.0, (0, 0, 0)), surface, fields)
        records.append(
            step_record(n, dt=1.0, volume_mm3=volume, area_mm2=10.0, **last.get(f"at{n}", {}))
        )
    return watch


def grown(*speeds, first=100.0):
    return first + np.concatenate([[0.0], np.cumsum(speeds)])


FAST, SLOW, AGAIN = [10.0] * 12, [1.0] * 12, [8.0] * 12


def test_a_front_that_slows_down_and_breaks_through_has_rested_in_between():
    volumes = grown(*FAST, *SLOW, *AGAIN)
    (plateau,) = watch_over(volumes).found
    assert 12 < plateau.step <= 24 and plateau.volume_mm3 == pytest.approx(volumes[plateau.step])
    assert 24 < plateau.left_at < 32


@pytest.mark.parametrize(
    "speeds",
    [
        [*FAST, *SLOW],  # comes to rest
        [*FAST, *[6.0] * 12, *AGAIN],  # never below half its peak
        [*FAST, *SLOW, *[1.5] * 60],  # creeps on
    ],
)
def test_a_front_that_converges_or_never_slows_has_no_plateau(speeds):
    assert watch_over(grown(*speeds)).found == ()


def test_after_an_overshoot_it_rests_where_it_is_smallest():
    volumes = grown(*FAST, *[1.0] * 6, *[-1.0] * 8, *[0.0] * 6, *AGAIN)
    (plateau,) = watch_over(volumes).found
    assert plateau.volume_mm3 == pytest.approx(volumes[26], abs=1.5)


def test_a_restart_alone_is_no_plateau():
    speeds = [*FAST, 0.0, 1.0, 2.0, 4.0, 7.0, *[10.0] * 20]
    assert watch_over(grown(*speeds)).found != ()
    assert watch_over(grown(*speeds), at12={"restarted": True}).found == ()


def test_no_more_plateaus_are_kept_than_wanted_and_another_level_begins_its_own():
    volumes = grown(*([*FAST, *SLOW] * 6))
    assert len(watch_over(volumes).found) == MAX_FOUND
    watch = watch_over(grown(*FAST, *SLOW))
    surface = ball()
    fields = StepFields(surface.band.cells, surface.band.psi, -np.ones(surface.size, np.float32))
    records = [
        step_record(n, dt=1.0, volume_mm3=v, area_mm2=10.0)
        for n, v in enumerate(grown(*AGAIN, first=500.0))
    ]
    for level in (0, 1):
        now = Moment(13, level, 620.0, 10.0, (0, 0, 0))
        found = watched(completed(watch, level, surface), records, now, surface, fields).found
        assert len(found) == 1 - level


def test_the_fastest_place_lies_in_the_largest_fast_part():
    surface = ball()
    index = np.stack(np.unravel_index(surface.band.cells, surface.shape), axis=1)
    speed = np.where(index[:, 2] > 16, -5.0, -1.0).astype(np.float32)
    speed[0] = -5.0  # a single cell elsewhere
    z, y, x = fastest_place(
        StepFields(surface.band.cells, speed, speed), surface.shape, (100, 0, 0)
    )
    assert x > 16 and abs(y - 11.5) < 6 and abs(z - 111.5) < 6


def test_psi_of_a_state_is_that_of_its_surface():
    surface = ball((10, 14, 12), 3.0)
    np.testing.assert_array_equal(
        psi_of(checkpoint_surface(surface), surface.shape, surface.gamma), surface.psi
    )


def joined_balls():
    """Two balls of one brightness, joined by a neck; the first one, and a start in it."""
    z, y, x = np.indices((36, 36, 72)) - np.array([17.5, 17.5, 0.0])[:, None, None, None]
    first = z**2 + y**2 + (x - 18) ** 2 < 13**2
    second = z**2 + y**2 + (x - 52) ** 2 < 15**2
    neck = (z**2 + y**2 < 3.2**2) & (x > 18) & (x < 52)
    return (first | second | neck) * 100.0, first


LEAK = {
    "start": "ball:18,17.5,17.5,4vox",
    "energy": "threshold:50,",
    "smoothness": 0.3,
    "max_steps": 400,
}


@pytest.fixture(scope="module")
def leaked():
    return accelsurf.segment(joined_balls()[0], **LEAK, levels=1, threads=1)


@pytest.mark.sampled(1)
@pytest.mark.threads
@pytest.mark.parametrize(
    "options", [{"levels": 1, "threads": 1}, {"levels": 1, "threads": 2}, {"levels": 2}]
)
def test_the_run_can_end_at_its_plateau(options, leaked):
    image, first = joined_balls()
    assert leaked.labels.sum() > 1.8 * first.sum() and len(leaked.objects[0].plateaus) == 1
    result = accelsurf.segment(image, **LEAK, **options, stop_at_rest=True)
    labels = result.labels > 0
    assert 2 * (labels & first).sum() > 0.93 * (labels.sum() + first.sum())
    if options["levels"] == 1:
        assert result.stop.reason == "rested" and "rested at step" in result.stop.message
        # Not one voxel beside the state of that step, at which a run of as many steps ends.
        step = leaked.objects[0].plateaus[0].step
        to_it = {**LEAK, **options, "max_steps": step, "end": "present"}
        np.testing.assert_array_equal(result.labels, accelsurf.segment(image, **to_it).labels)


def test_the_result_says_where_it_broke_through(leaked):
    (plateau,) = leaked.objects[0].plateaus
    x, y, z = plateau.place
    assert 28 < x < 46 and abs(y - 17.5) < 5 and abs(z - 17.5) < 5
    (note,) = [note for note in leaked.quality.notes if note.startswith("rest: ")]
    assert f"rested at step {plateau.step}" in note and "--stop-at-rest" in note
