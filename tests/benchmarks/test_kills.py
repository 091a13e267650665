"""A few trials of `benchmarks.kills`; the command has many."""

import pytest

from benchmarks import kills, resumed


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return kills.Bench.prepared(tmp_path_factory.mktemp("kills"), seed=1)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("kills", 2), ("interrupts", 2), ("full disks", 1)])
def test_no_run_leaves_files_that_do_not_belong_together(kind, count, bench):
    found = kills.run_trials(bench, {kind: count})[kind]
    assert found["runs"] == count and found["faults"] == []


@pytest.mark.slow
def test_killed_runs_go_on_to_the_same_files(tmp_path):
    found = resumed.trials(tmp_path, count=1, seed=3)
    assert found["runs"] == 1 and found["kills"] > 0 and found["faults"] == []


@pytest.mark.slow
def test_files_that_do_not_belong_together_are_seen(bench):
    path = bench.results / "ball_trace.csv"
    good = path.read_bytes()
    assert kills.fault_of(bench.results) == ""
    path.write_bytes(good + b"1")
    assert kills.fault_of(bench.results) == "mixed: ball_trace.csv is not the one of the report"
    path.unlink()
    assert kills.fault_of(bench.results) == "mixed: ball_trace.csv is missing"
    path.write_bytes(good)
    (bench.results / "ball_surface.xyz").write_bytes(b"")
    assert kills.fault_of(bench.results) == "mixed: ball_surface.xyz beside the report"
    (bench.results / "ball_surface.xyz").unlink()
