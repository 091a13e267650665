"""The pool of worker processes: what becomes of jobs whose worker dies, hangs, fails or grows too large."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from accelsurf.batch import pool as pools
from accelsurf.batch.pool import Ended, Interrupted, Job, LocalPool, Started
from accelsurf.errors import AccelsurfError
from tests.support import batch_jobs

MB = 1 << 20


@pytest.fixture
def pool(request):
    made = []

    def of(jobs=1, **options):
        made.append(LocalPool(batch_jobs.work, jobs, **options))
        return made[-1]

    yield of
    for one in made:
        one.close()


def outcomes(pool, jobs):
    for job in jobs:
        pool.submit(job)
    events = list(pool.events())
    ended = {event.key: event for event in events if isinstance(event, Ended)}
    assert sum(isinstance(event, Ended) for event in events) == len(ended) == len(jobs)
    return ended, events


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_worker_that_dies_is_replaced_and_the_others_go_on(pool):
    jobs = [
        Job("a", ("double", 2)),
        Job("killed", ("die", 0)),
        Job("raises", ("raise", "no such thing")),
        Job("out of memory", ("memory", "for 5 GB")),
        Job("cannot be sent", ("unsendable", 0)),
        Job("ends", ("exit", 7)),
        Job("b", ("double", 21)),
    ]
    found, events = outcomes(pool(2), jobs)
    assert (found["a"].value, found["b"].value) == (4, 42) and found["b"].failure is None
    kinds = {key: one.failure.kind for key, one in found.items() if one.failure is not None}
    assert kinds == {
        "killed": "killed",
        "raises": "error",
        "out of memory": "memory",
        "cannot be sent": "error",
        "ends": "killed",
    }
    assert (
        "SIGKILL" in found["killed"].failure.message
        and "exit code 7" in found["ends"].failure.message
    )
    assert found["raises"].failure.message == "ValueError: no such thing"
    assert "batch_jobs.py" in found["raises"].failure.details
    for key in found:
        assert events.index(Started(key)) < events.index(found[key])


def test_a_job_that_hangs_is_ended_and_loading_does_not_count(pool):
    one = pool(1, timeout=0.5, prepare=batch_jobs.sleep_first)
    began = time.monotonic()
    found, _ = outcomes(one, [Job("hangs", ("hang", 0)), Job("good", ("double", 1))])
    assert found["hangs"].failure.kind == "timeout" and "0.5 s" in found["hangs"].failure.message
    assert found["good"].value == 2 and time.monotonic() - began < 60


def test_one_worker_does_many_jobs_and_is_recycled(pool, monkeypatch):
    monkeypatch.setattr(pools, "JOBS_PER_WORKER", 3)
    found, _ = outcomes(pool(1), [Job(str(number), ("pid", 0)) for number in range(7)])
    pids = [found[str(number)].value for number in range(7)]
    assert len(set(pids[:3])) == len(set(pids[3:6])) == 1 and len(set(pids)) == 3


def test_jobs_wait_for_room_and_those_that_never_fit_fail(pool):
    jobs = [
        Job("a", ("pid later", 0.3), 6),
        Job("b", ("pid later", 0.3), 6),
        Job("large", ("double", 1), 11),
    ]
    found, events = outcomes(pool(2, bytes=10), jobs)
    assert found["large"].failure.kind == "memory" and Started("large") not in events
    assert events.index(found["a"]) < events.index(Started("b"))  # one after the other
    assert found["a"].value == found["b"].value  # so one worker was enough


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not say how large a process is"
)
def test_a_worker_that_takes_too_much_memory_is_ended(pool):
    found, _ = outcomes(
        pool(1, limit=400 * MB), [Job("eats", ("eat", 600 * MB)), Job("good", ("double", 3))]
    )
    assert found["eats"].failure.kind == "memory" and "may be used" in found["eats"].failure.message
    assert found["good"].value == 6


def test_workers_that_cannot_start_are_not_started_for_ever(pool):
    one = pool(1, prepare=batch_jobs.cannot_load)
    with pytest.raises(AccelsurfError, match="cannot be started"):
        outcomes(one, [Job(str(number), ("double", 1)) for number in range(9)])


def test_a_worker_that_is_killed_while_it_has_nothing_to_do_costs_no_job(pool):
    one = pool(1)
    found, _ = outcomes(one, [Job("a", ("pid", 0))])
    os.kill(found["a"].value, signal.SIGKILL)
    one.workers[0].process.join()
    found, _ = outcomes(one, [Job("b", ("double", 4))])
    assert found["b"].value == 8


def test_close_ends_what_runs(pool):
    one = pool(2)
    for number in range(3):
        one.submit(Job(str(number), ("hang", 0)))
    events = one.events()
    assert [next(events), next(events)] == [Started("0"), Started("1")]
    pids = [worker.process.pid for worker in one.workers]
    one.close()
    assert len(pids) == 2 and not any(map(is_alive, pids))


PARENT = """
import sys
from accelsurf.batch.pool import Job, LocalPool
from tests.support import batch_jobs

if __name__ == "__main__":
    pool = LocalPool(batch_jobs.work, 2)
    for path in sys.argv[1:]:
        pool.submit(Job(path, ("mark", path)))
    for number, event in enumerate(pool.events(), 1):
        if number == len(sys.argv) - 1:
            print(*(worker.process.pid for worker in pool.workers), flush=True)
"""


def test_no_worker_outlives_a_parent_that_is_killed(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    marks = [tmp_path / "a", tmp_path / "b"]
    command = [sys.executable, tmp_path / "parent.py", *marks]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2
        wait_until(lambda: all(mark.exists() for mark in marks))
        parent.send_signal(signal.SIGKILL)
    wait_until(lambda: not any(map(is_alive, pids)))
    assert not any(map(is_alive, pids))


def wait_until(condition):
    end = time.monotonic() + 30
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)


def test_who_does_not_want_to_wait_need_not(tmp_path):
    pool = LocalPool(batch_jobs.work, 1)
    pool.submit(Job("a", ("mark", str(tmp_path / "mark"))))
    with ThreadPoolExecutor(1) as other:
        waiting = other.submit(lambda: list(pool.events()))
        while not (tmp_path / "mark").exists():
            time.sleep(0.01)
        pool.interrupt()
        with pytest.raises(Interrupted):
            waiting.result(timeout=30)
    pool.close()
    pool.interrupt()
