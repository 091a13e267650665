"""Jobs on a Dask cluster of this machine: values, failures, workers that are lost, clusters that will not do."""

import math
import os
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from distributed import LocalCluster

from accelsurf.batch import dask_pool
from accelsurf.batch.dask_pool import DaskPool
from accelsurf.batch.pool import Ended, Interrupted, Job, Started
from accelsurf.errors import UsageError
from tests.support.batch_jobs import work


@pytest.fixture(scope="module")
def cluster():
    made = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True)
    with made as running:
        yield running


def ended(pool, jobs):
    """The end of each job by its key."""
    try:
        for key, payload in jobs.items():
            pool.submit(Job(key, payload))
        events = list(pool.events())
        assert [one.key for one in events if isinstance(one, Started)] == list(jobs)
        return {one.key: one for one in events if isinstance(one, Ended)}
    finally:
        pool.close()


def test_values_and_failures_come_back(cluster):
    found = ended(
        DaskPool(work, cluster.scheduler_address),
        {"a": ("double", 4), "b": ("raise", "no"), "c": ("memory", ""), "d": ("unsendable", 1)},
    )
    assert found["a"].value == 8 and found["a"].failure is None
    assert found["b"].failure.kind == "error" and found["b"].failure.message == "ValueError: no"
    assert "Traceback" in found["b"].failure.details
    assert found["c"].failure.kind == "memory"
    assert found["d"].failure is not None or callable(found["d"].value)


def test_a_job_that_ends_its_workers_has_failed_and_the_others_go_on(cluster):
    found = ended(
        DaskPool(work, cluster.scheduler_address), {"a": ("die", None), "b": ("double", 3)}
    )
    assert found["a"].failure.kind == "killed" and "was lost" in found["a"].failure.message
    assert found["b"].value == 6


def test_workers_work_where_the_command_was_given(cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ended(DaskPool(os.path.abspath, cluster.scheduler_address), {"a": "x"})[
        "a"
    ].value == str(tmp_path / "x")


def test_who_does_not_want_to_wait_need_not(cluster):
    """What a worker has begun it ends: a cluster cannot stop it."""
    pool = DaskPool(work, cluster.scheduler_address)
    pool.submit(Job("a", ("pid later", 5.0)))
    with ThreadPoolExecutor(1) as other:
        began = time.monotonic()
        waiting = other.submit(lambda: list(pool.events()))
        time.sleep(0.5)
        pool.interrupt()
        with pytest.raises(Interrupted):
            waiting.result(timeout=30)
        assert time.monotonic() - began < 4.5
    pool.close()


def test_another_version_on_a_worker_is_named(cluster, monkeypatch):
    monkeypatch.setattr(dask_pool, "__version__", "0.0.0")
    failure = ended(DaskPool(math.sqrt, cluster.scheduler_address), {"a": 4.0})["a"].failure
    assert "expected 0.0.0" in failure.message and "accelsurf[dask]" in failure.message


def test_workers_with_several_threads_are_refused():
    made = LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0", processes=False)
    with made as several, pytest.raises(UsageError, match="has 2 threads, expected one"):
        DaskPool(math.sqrt, several.scheduler_address)


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(dask_pool, "CONNECT_SECONDS", 1)
    with pytest.raises(UsageError, match="tcp://127.0.0.1:9 does not answer"):
        DaskPool(math.sqrt, "tcp://127.0.0.1:9")
    with pytest.raises(UsageError, match="absent.json is no file and no address"):
        DaskPool(math.sqrt, "/absent.json")
