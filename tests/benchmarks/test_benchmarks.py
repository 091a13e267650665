"""The benchmarks beside the peers: what they count, the search's rule, RESULTS.md from JSON. Tiny sizes."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.image.volume import Volume
from accelsurf.starts.objects import ObjectStart
from benchmarks import benchmark, defaults, real_scans, turns
from benchmarks.peers import baselines, comparison, hard_works, objects, programs, render, scans
from benchmarks.peers.advance import grow, sparse_field
from benchmarks.peers.clock import Clock
from benchmarks.peers.measure import (
    MissingError,
    Options,
    Trial,
    best,
    goal,
    in_turn,
    machine,
    ranked,
    repeats_for,
    run_process,
    search,
    table,
)
from benchmarks.peers.memory import fitted
from benchmarks.peers.work import ball, noisy_cube, radius_error, scan


@pytest.fixture(autouse=True)
def environment_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """The benchmarks set variables of the process."""
    monkeypatch.setattr("os.environ", os.environ.copy())


def trial(name: str, dice: float, seconds: float) -> Trial:
    return Trial({"name": name}, dice, seconds)


def test_the_best_setting_is_the_fastest_of_those_as_good_as_the_highest() -> None:
    trials = [trial("slow", 0.991, 9.0), trial("fast", 0.9895, 2.0), trial("poor", 0.9885, 0.1)]
    assert best(trials).settings["name"] == "fast"
    assert [t.settings["name"] for t in ranked(trials)] == ["fast", "slow", "poor"]


@pytest.mark.slow
def test_the_search_tries_the_grid_then_refines_its_best() -> None:
    asked: list[dict[str, Any]] = []

    def run(settings: dict[str, Any]) -> float:
        asked.append(settings)
        return settings["sigma"] * 0.1 + settings["iterations"] * 0.01

    coarse = [{"sigma": 1.0, "iterations": 10}, {"sigma": 2.0, "iterations": 10}]
    trials = search(run, coarse, {"iterations": (0.5, 1.0, 2.0)})
    assert asked == [*coarse, {"sigma": 2.0, "iterations": 5}, {"sigma": 2.0, "iterations": 20}]
    assert best(trials).settings == {"sigma": 2.0, "iterations": 20} and isinstance(
        asked[-1]["iterations"], int
    )


def test_a_search_that_runs_out_of_time_says_what_it_left_out() -> None:
    messages: list[str] = []
    assert (
        len(
            search(
                lambda settings: 0.5,
                [{"a": 1}, {"a": 2}, {"a": 3}],
                limit_s=-1.0,
                say=messages.append,
            )
        )
        == 1
    )
    assert messages == ["search stopped after -1 s, 2 settings not tried"]


def test_long_runs_are_timed_once_more_and_hopeless_ones_twice() -> None:
    options = Options(repeats=5)
    assert [repeats_for(trial("", 0.9, s), options) for s in (1.0, 61.0)] == [5, 1]
    assert repeats_for(trial("", 0.5, 1.0), options, hopeless=True) == 2


@pytest.mark.slow
def test_programs_take_turns() -> None:
    order: list[str] = []
    times = in_turn(
        {"a": lambda: order.append("a"), "b": lambda: order.append("b")}, {"a": 3, "b": 2}
    )
    assert order == ["a", "b", "a", "b", "a"] and len(times["b"].seconds) == 2


def test_a_peer_that_is_not_installed_is_skipped_with_a_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    absent = programs.Peer("gone", "no_such_module_here", "no-such", programs.c3d, [])
    monkeypatch.setattr(comparison, "PEERS", {"gone": absent})
    options = Options()
    assert comparison.available(options) == [] and comparison.available(options) == []
    assert options.messages == ["gone: skipped, no-such is not installed (pip install no-such)"]


@pytest.mark.slow
def test_march_without_scikit_fmm_says_so_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.peers import march

    monkeypatch.setattr(march.importlib.util, "find_spec", lambda name: None)
    options = Options(quick=True, repeats=1)
    result = march.march(options)
    assert "scikit-fmm" in options.messages[0] and result["goals"][0]["measured"] is None
    assert render.verdict(result["goals"][0]) == "not measured" and result["band_cells"] > 1000


@pytest.mark.parametrize(
    "name", ["SimpleITK ThresholdSegmentation", "scikit-image morphological_chan_vese"]
)
def test_peers_find_a_clean_cube(name: str) -> None:
    image, truth, _, start = noisy_cube(24)
    peer = programs.PEERS[name]
    labels = peer.run(
        truth.astype(np.float32),
        start,
        (1.0, 0.0),
        peer.scaled({**peer.coarse[0], "sigma": 0.5}, 48),
    )
    assert (
        labels.shape == image.shape
        and 2 * (labels & truth).sum() / (labels.sum() + truth.sum()) > 0.95
    )


@pytest.mark.sampled(2)
@pytest.mark.filterwarnings("ignore:The probability range is outside")
@pytest.mark.parametrize("name", list(baselines.BASELINES))
def test_baselines_find_a_cube_in_noise(name: str) -> None:
    image, truth, _, start = noisy_cube(32)
    rng = np.random.default_rng(2)
    image = (truth + 0.3 * rng.normal(size=truth.shape)).astype(np.float32)
    image[2, 2, 2:6] = 5.0  # a speck that is no part of it
    peer = baselines.BASELINES[name]
    labels = peer.run(image, start, (1.0, 0.0), peer.coarse[0])
    assert (
        2 * (labels & truth).sum() / (labels.sum() + truth.sum()) > 0.97
        and not labels[2, 2, 2:6].any()
    )


def test_the_graph_cut_has_the_least_energy_of_all_labels() -> None:
    image = np.random.default_rng(4).normal(0.5, 0.6, (1, 3, 4)).astype(np.float32)
    start = np.full(image.shape, 1.0)
    start[0, 1, 1] = -1.0
    every = (np.arange(2**12)[:, None] >> np.arange(12) & 1).astype(bool).reshape(-1, 3, 4)
    every = every[every[:, 1, 1]]
    cost = (image[0] - 1.0) ** 2 - image[0] ** 2
    faces = sum(np.diff(every, axis=axis).sum(axis=(1, 2)) for axis in (1, 2))
    best_one = every[np.argmin((every * cost).sum(axis=(1, 2)) + 0.3 * faces)]
    found = baselines.graph_cut(image, start, (1.0, 0.0), {"weight": 0.3})[0]
    parts, _ = ndimage.label(best_one)
    assert np.array_equal(found, parts == parts[1, 1]) and 2 < found.sum() < 11


@pytest.mark.parametrize("name", list(hard_works.WORKS))
def test_works_have_clicks_on_their_sides_and_no_threshold(name: str) -> None:
    work = hard_works.WORKS[name](1, 48)
    for own, click in work.inside.items():
        assert (work.truth[hard_works.drawn(work.truth.shape, click)] == own).mean() > 0.7
    assert all(
        not work.truth[hard_works.drawn(work.truth.shape, click)].any() for click in work.outside
    )
    middle = sum(work.means) / 2
    assert work.score(work.truth) == 1.0 and work.score((work.image > middle).astype(int)) < 0.9


@pytest.mark.slow
def test_peers_find_two_touching_balls_each(monkeypatch: pytest.MonkeyPatch) -> None:
    # One setting each, so that nothing hangs on how many fit into the time.
    name = "scikit-image morphological_chan_vese"
    one = replace(programs.PEERS[name], coarse=programs.PEERS[name].coarse[:1], fine={})
    monkeypatch.setattr(scans, "PEERS", {name: one})
    monkeypatch.setattr(objects, "WATERSHEDS", [{"sigma": 1.0, "flooded": "value", "where": 0.4}])
    z, y, x = np.indices((24, 24, 36)) - np.array([11.5, 11.5, 11.5])[:, None, None, None]
    truth = np.where(z**2 + y**2 + x**2 < 8**2, 3, 0) + np.where(
        z**2 + y**2 + (x - 15) ** 2 < 7**2, 5, 0
    )
    image = Volume.from_array((truth > 0) * 100.0, 1.0)
    psi = [np.sqrt(z**2 + y**2 + (x - at) ** 2) - 3 for at in (0, 15)]
    starts = [
        ObjectStart(own, (0, 0, 0), np.float32(one)) for own, one in zip((3, 5), psi, strict=True)
    ]
    found = objects.compare_on_objects(
        image, truth, starts, scans.best_window(image.array, truth > 0), 60.0
    )
    assert found["best"]["scikit-image watershed"]["dice"] > 0.95
    assert found["best"]["SimpleITK watershed"]["dice"] > 0.95
    assert found["best"]["scikit-image morphological_chan_vese, shared out"]["dice"] > 0.9
    assert objects.mean_dice(np.where(truth == 3, 5, 3), truth) == 0.0


def test_radius_is_read_alike_from_every_result() -> None:
    exact = radius_error(ball(32, 10.0), 10.0)
    assert exact["volume_error"] < 0.03 and exact["rms_error"] < 0.03
    assert radius_error(ball(32, 10.5), 10.0)["volume_error"] == pytest.approx(0.5, abs=0.03)
    assert radius_error(grow(ball(32, 8.0), 2.0), 10.0)["rms_error"] < 0.1
    assert (
        radius_error(sparse_field("ThresholdSegmentation", ball(32, 8.0), 12), 10.0)["volume_error"]
        < 0.5
    )


def test_the_clock_counts_kernels_and_stages() -> None:
    from accelsurf.levelset import LevelSet, Workers

    workers = Workers(1)
    clock = Clock(workers)
    LevelSet(ball(16, 5.0), (1.0, 1.0, 1.0), 3.0, workers)
    assert clock.parallel > 0 and len(clock.kernels) >= 1
    clock.reset()
    assert clock.parallel == 0


def test_memory_is_split_into_voxels_and_band() -> None:
    lines = [
        {
            "side": n,
            "hold_bytes": 1e6,
            "run_bytes": 3e6 + 10.0 * n**3 + 50.0 * 7 * n**2,
            "band_cells": 7 * n**2,
        }
        for n in (64, 128, 256)
    ]
    assert fitted(lines) == pytest.approx((10.0, 50.0, 2e6), rel=1e-6)


def test_a_missing_scan_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ACCELSURF_VOLUMES", raising=False)
    for folder in (None, tmp_path):
        with pytest.raises(MissingError, match="niivue"):
            scan(folder, "mri_brain256.nii.gz")
    assert benchmark.main(["segment-real", "--quick", "--results", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_process_that_fails_is_reported_by_its_last_line() -> None:
    import sys

    with pytest.raises(MissingError, match="ended with 3: sorry"):
        run_process([sys.executable, "-c", "import sys; print('sorry'); sys.exit(3)"], 1)


def result_of(measured: float | None, **more: Any) -> dict[str, Any]:
    return {
        "machine": machine(),
        "work": "a test",
        "quick": False,
        "goals": [goal("times faster", 10.0, measured), goal("seconds", 3.0, 4.5, "<=", "s")],
        "tables": [table("All", ("program", "Dice"), [("one", 0.98765), ("two", None)])],
        "pairs": [{"pair": "one / two", "ratio": 2.345}],
        "messages": ["two: skipped"],
        "bars": [["one", 1.0]],
        **more,
    }


def test_every_benchmark_is_shown() -> None:
    assert set(render.NAMES) == set(benchmark.BENCHMARKS)


def test_results_are_rendered_from_json_alone(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    for name, measured in (("advance", 12.0), ("march", 4.0)):
        result = result_of(measured)
        result["picture"] = render.picture(folder, name, result)
        render.json_path(folder, name).write_text(json.dumps(result))
    notes = tmp_path / "notes.toml"
    notes.write_text('march = "What is counted."\n')
    text = render.render(folder, tmp_path / "RESULTS.md", notes).read_text()
    assert (
        "| [march](#march) | a test | times faster: 10x | 4x | no, 2.5 times too little |" in text
    )
    assert "|  |  | seconds: at most 3 s | 4.5 s | no, 1.5 times too much |" in text
    assert "| 12x | yes |" in text and "What is counted." in text and "* two: skipped" in text
    assert "| one | 0.9877 |" in text and "| two | - |" in text and "| one / two | 2.35 |" in text
    assert "Not run: segment-noise" in text and "![march](results/benchmark_march.png)" in text
    assert text.index("## march") < text.index("## advance")
    assert (folder / "benchmark_march.png").stat().st_size > 1000


def test_short_of_a_difference_is_reported_as_a_difference() -> None:
    assert (
        render.verdict(goal("Dice less the best", 0.0, -0.0312, unit="")) == "no, short by 0.0312"
    )
    assert render.verdict(goal("x", 1.0, None)) == "not measured"


@pytest.mark.slow
def test_the_command_writes_json_with_machine_and_raw_times(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert benchmark.main(["advance", "--quick", "--results", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "benchmark_advance.json").read_text())
    assert (
        result["machine"]["cores"] >= 1 and result["machine"]["packages"]["numpy"] == np.__version__
    )
    by_threads = result["programs"]["accelsurf"]["threads"]
    assert [len(by_threads[n]["seconds"]) for n in ("1", "2")] == [1, 1] and result["quick"]
    assert {pair["pair"].rpartition(", ")[2] for pair in result["pairs"]} == {
        "1 thread",
        "2 threads",
    }
    assert (tmp_path / "RESULTS.md").is_file() and (tmp_path / "benchmark_advance.png").is_file()
    with pytest.raises(SystemExit):
        benchmark.main(["no-such"])
    assert "no such benchmark" in capsys.readouterr().err


def test_a_work_that_became_slower_than_at_another_commit_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(turns, "checked_out", lambda commit: contextlib.nullcontext(turns.ROOT))
    for new, code, end in ((2.2, 0, "1.10\n"), (2.4, 1, "1.20  SLOWER\n"), (1.0, 0, "0.50\n")):
        found = {"start": (1.0, 1.14), "click": (2.0, new)}
        monkeypatch.setattr(turns, "in_turns", lambda *given, found=found: found)
        assert turns.main([]) == code
        assert capsys.readouterr().out.endswith(end)


def test_a_tree_does_each_work_and_a_commit_that_is_not_there_is_one_line() -> None:
    with turns.Child(turns.ROOT) as child:
        assert child.seconds("advance") > 0
        with pytest.raises(SystemExit, match="error: 'no such work' failed"):
            child.seconds("no such work")
    assert tuple(turns.works()) == turns.WORKS
    with (
        pytest.raises(SystemExit, match="error: no-such: git has no such commit"),
        turns.checked_out("no-such"),
    ):
        pass


@pytest.mark.parametrize(("study", "entries"), [(defaults, "rows"), (real_scans, "cases")])
def test_the_table_of_a_page_is_that_of_its_json(study: Any, entries: str) -> None:
    found = json.loads(study.RESULTS_FILE.read_text())[entries]
    table = study.text_of(found.values() if study is defaults else found)
    assert len(table) > 500 and table.strip() in study.PAGE.read_text()
