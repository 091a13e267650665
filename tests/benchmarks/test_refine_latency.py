"""The latency of a click: all that is timed exists, and the parts add up to the whole."""

import json
import time

import pytest

from benchmarks import refine


def test_each_click_is_measured_by_part(tmp_path, monkeypatch):
    monkeypatch.setattr(refine, "REPEATS", 1)
    assert (
        refine.main(
            ["--objects", "two_balls", "--size", "40", "--clicks", "2", "--results", str(tmp_path)]
        )
        == 0
    )
    description = json.loads((tmp_path / refine.NAME).read_text())
    first, later = description["clicks"]
    assert (first["click"], later["click"]) == (1, 2)
    for row in description["clicks"]:
        assert sum(row["parts"].values()) == pytest.approx(row["cpu_s"], rel=0.05, abs=0.01)
        assert row["wall_s"] > 0
    model = (
        "windows",
        "features",
        "arrival times",
        "paths",
        "walks",
        "network",
        "the model's object",
        "area's weight",
    )
    for part in (*model, "first band", "steps"):
        assert first["parts"][part] > 0, part
    for part in (*model, "region", "steps"):
        assert later["parts"][part] > 0, part
    assert 0 < later["first_step_s"] <= later["wall_s"]
    page = refine.page_of(description)
    assert "| phantoms, later | 1 |" in page and f"| two_balls | 2 | {later['side']} |" in page


def test_time_in_an_inner_part_is_not_that_of_the_outer_one():
    timer = refine.Timer()

    def busy(seconds):
        began = time.thread_time()
        while time.thread_time() - began < seconds:
            pass

    inner = timer.timed(lambda: busy(0.03), "inner")

    def both():
        inner()
        busy(0.01)

    timer.timed(both, "outer")()
    assert timer.seconds["inner"] == pytest.approx(0.03, abs=0.008)
    assert timer.seconds["outer"] == pytest.approx(0.01, abs=0.008)
