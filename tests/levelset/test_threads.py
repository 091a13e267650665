"""Workers: each slot once, sums in order, the same bytes for any number of threads, errors not swallowed."""

import threading
import time

import numpy as np
import pytest

from accelsurf.kernels.grid import BLOCK
from accelsurf.levelset import LevelSet, Workers
from accelsurf.levelset import threads as sharing
from accelsurf.levelset.closest_points import find_closest_points
from tests.support import reference
from tests.support.level_set_checks import check_level_set

GRAIN = sharing.GRAIN
pytestmark = pytest.mark.threads
SIZES = [0, 1, GRAIN - 1, GRAIN, GRAIN + 1, BLOCK - 1, BLOCK, BLOCK + 1, 7 * BLOCK + 3, 40 * BLOCK]


@pytest.mark.sampled
@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("size", SIZES)
def test_ranges_cover_every_slot_once(threads, size):
    seen = np.zeros(size, int)
    lock = threading.Lock()

    def kernel(start, stop, step):
        with lock:
            seen[start:stop] += step

    with Workers(threads) as workers:
        workers.parallel(kernel, size, 3)
    assert (seen == 3).all()


@pytest.mark.parametrize("size", SIZES)
def test_sums_are_the_same_bytes_for_any_number_of_threads(size):
    values = np.random.default_rng(1).standard_normal(size) * 1e3

    def kernel(first, last, given, rows):
        for block in range(first, last):
            part = given[block * BLOCK : (block + 1) * BLOCK]
            rows[block] = part.sum(), (part**2).sum()

    results = []
    for threads in (1, 2, 3):
        with Workers(threads) as workers:
            results.append(workers.block_sums(kernel, size, 2, values))
    assert results[0].tobytes() == results[1].tobytes() == results[2].tobytes()
    np.testing.assert_allclose(results[0], [values.sum(), (values**2).sum()], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_in_a_range_is_raised(threads):
    def kernel(start, stop):
        if stop > 3 * BLOCK:
            raise ZeroDivisionError("in a range")

    with Workers(threads) as workers, pytest.raises(ZeroDivisionError, match="in a range"):
        workers.parallel(kernel, 4 * BLOCK)


@pytest.mark.parametrize("raising", ["this", "other"])
def test_an_error_in_either_thread_reaches_the_caller(raising):
    """Both are at work when one raises."""
    both, met = threading.Barrier(2, timeout=30), threading.local()

    def kernel(start, stop):
        if not getattr(met, "already", False):
            met.already = True
            both.wait()
            if (threading.current_thread() is threading.main_thread()) == (raising == "this"):
                raise ZeroDivisionError(raising)

    with Workers(2) as workers:
        with pytest.raises(ZeroDivisionError, match=raising):
            workers.parallel(kernel, 40 * BLOCK)
        # They go on working.
        seen = []
        workers.parallel(lambda start, stop: seen.append(stop - start), 40 * BLOCK)
    assert sum(seen) == 40 * BLOCK
    assert set(workers.seconds) == {"<lambda>"}


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_seconds_by_kernel_add_up(threads):
    def slow(start, stop):
        time.sleep(0.01)

    def summed(first, last, rows):
        rows[first:last] = 1

    def lonely(value):
        time.sleep(0.02)
        return value

    with Workers(threads) as workers:
        began = time.perf_counter()
        workers.parallel(slow, 3)
        once = workers.seconds["slow"]
        workers.parallel(slow, 3)
        workers.parallel(slow, 0)
        assert workers.block_sums(summed, 5 * BLOCK, 1) == 5
        assert workers.serial(lonely, 7) == 7
        whole = time.perf_counter() - began
    assert set(workers.seconds) == {"slow", "summed", "lonely"}
    assert once >= 0.01
    assert workers.seconds["slow"] >= once + 0.01
    assert workers.seconds["lonely"] >= 0.02
    assert sum(workers.seconds.values()) <= whole


def test_a_noisy_surface_is_the_same_bytes_with_one_two_and_three_threads():
    """Closest points in many rounds: cells that enter, and closest points adopted everywhere."""
    psi, results = reference.smooth_noise((36, 40, 42), 4, 0.9), []
    for threads in (1, 2, 3):
        with Workers(threads) as workers:
            surface = LevelSet(psi, (1.5, 1.0, 0.8), workers=workers)
            assert surface.size > 4 * BLOCK
            seen = [surface.psi.copy(), surface.band.to_closest]
            surface.advance(np.sin(surface.band.cells * 0.37).astype(np.float32), 0.6)
            cells, closest_point, state, n = find_closest_points(surface)
            results.append(
                b"".join(
                    np.asarray(a).tobytes()
                    for a in [*seen, cells[:n], closest_point[:n], state[:n]]
                )
            )
    assert results[0] == results[1] == results[2]


def test_threads_work_at_the_same_time():
    names = set()

    def kernel(start, stop):
        names.add(threading.current_thread().name)
        time.sleep(0.02)

    with Workers(2) as workers:
        workers.parallel(kernel, 8 * BLOCK)
    assert len(names) == 2


def test_closed_workers_do_no_more():
    workers = Workers(2)
    workers.close()
    with pytest.raises(RuntimeError):
        workers.parallel(lambda start, stop: None, 4 * BLOCK)


def test_a_moving_surface_is_the_same_bytes_with_one_two_and_three_threads():
    """Several blocks, unequal spacing, topology changes at the border: all that a step computes."""
    psi = reference.smooth_noise((40, 48, 44), 3, 3.0)
    results = []
    for threads in (1, 2, 3):
        with Workers(threads) as workers:
            surface = LevelSet(psi, (1.5, 1.0, 0.8), workers=workers)
            assert surface.size > 4 * BLOCK
            field = np.cos(surface.band.cells * 0.01).astype(np.float32)
            seen = []
            for _ in range(4):
                front = surface.front()
                surface.extend_outwards(field, front)
                surface.advance(field, 0.3)
                seen += [front, surface.remove_small()]
                change = surface.redistance([field])
                (field,) = change.fields
                seen += [*surface.fraction_and_area(), surface.curvature(surface.front()), field]
                seen += [surface.psi, surface.band.to_closest]
                seen += [change.entered_inside, change.left_inside, surface.band.cells]
            results.append(b"".join(np.asarray(a).tobytes() for a in seen))
            assert check_level_set(surface, last=6) == []
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize(
    "expected, pieces", [(None, 8), (0.0, 1), (0.9, 1), (1.01, 2), (1.9, 3), (3.1, 6), (100.0, 8)]
)
def test_what_is_shared_out_depends_on_the_time_it_took(monkeypatch, expected, pieces):
    """In ranges of half a second from a second on, at most four for each thread; so many for a kernel not known yet."""
    monkeypatch.setattr(sharing, "SHARED_FROM", 1.0)
    monkeypatch.setattr(sharing, "SHORTEST", 0.5)
    size, seen = 240 * GRAIN, []
    with Workers(2) as workers:
        if expected is not None:
            workers.pace["<lambda>"] = expected / size
        workers.parallel(lambda start, stop: seen.append((start, stop)), size)
    assert sorted(seen) == [(i * size // pieces, (i + 1) * size // pieces) for i in range(pieces)]
    assert all(start % GRAIN == 0 for start, _ in seen)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_pace_of_a_kernel_is_that_of_its_last_call(threads):
    """Of the seconds of all threads together; a call of one grain says nothing."""
    size = 8 * GRAIN

    def kernel(start, stop, seconds):
        time.sleep(seconds * (stop - start) / size)

    with Workers(threads) as workers:
        workers.parallel(kernel, size, 0.4)
        assert workers.pace["kernel"] * size >= 0.4
        workers.parallel(kernel, size, 0.0)
        fast = workers.pace["kernel"]
        assert fast * size < 0.4
        workers.parallel(kernel, GRAIN, 4.0)
        assert workers.pace["kernel"] == fast
