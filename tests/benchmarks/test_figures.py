"""What the paper's experiments count, on shapes small enough to count by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.figures import common, cube, speed, tuned


def test_corner_dice_sees_only_the_corners() -> None:
    truth, _ = common.make(common.box((1, 60, 60), (0, 15, 15), (1, 45, 45), 0.0, 0))
    assert common.corner_dice(truth, truth) == 1.0
    far = truth.copy()
    far[0, 28:32, 15] = False  # the middle of a side
    assert common.corner_dice(far, truth) == 1.0
    near = truth.copy()
    near[0, 15:18, 15:18] = False
    assert common.corner_dice(near, truth) < 0.97


def test_edges_of_a_box_count_as_corners_in_3d() -> None:
    truth, _ = common.make(common.box((30,) * 3, (8,) * 3, (22,) * 3, 0.0, 0))
    along = truth.copy()
    along[8, 8, 14:16] = False
    assert common.corner_dice(along, truth) < 1.0


def test_a_run_reports_its_figures_and_json_leaves_arrays_out(tmp_path: Path) -> None:
    shape = common.box((1, 32, 32), (0, 8, 8), (1, 24, 24), 0.1, 3)
    description = common.run(
        common.Task(("a", 1), shape, {"start": "ball:16,16,0,5vox", "max_steps": 100})
    )
    assert (
        description["dice"] > 0.95
        and description["hausdorff_mm"] < 3
        and description["cells_visited"] > 1000
    )
    common.write(tmp_path, "one", {"runs": [description], "bad": float("nan")})
    document = json.loads((tmp_path / "one.json").read_text())
    assert document["bad"] is None and "labels" not in document["runs"][0]
    assert document["runs"][0]["name"] == ["a", 1]


def test_the_cube_counts_runs_that_found_it() -> None:
    truth, _ = common.make(cube.CUBE)
    run = {
        "corner_dice": 1.0,
        "energy": 1.0,
        "steps": 5,
        "stop": "converged",
        "cells_visited": 9,
        "labels": truth,
    }
    line = cube.summary(
        "x", [{**run, "dice": 0.95}, {**run, "dice": 0.85}, {**run, "dice": 0.3, "stop": "stalled"}]
    )
    assert (line["found"], line["good"], line["of"], line["converged"]) == (2, 1, 3, 2)
    assert len(set(cube.starts())) == cube.STARTS and cube.starts() == cube.starts()


def test_steps_to_one_percent_of_the_gap() -> None:
    energy = np.array([10.0, 5.0, 1.05, 1.0, 1.0])
    run = {"energy": energy, "cells": np.arange(6) * 10, "seconds": np.arange(6.0)}
    entry = speed.line("gradient", 32, 3, run, 1.0)
    assert (entry["steps"], entry["cells_visited"], entry["seconds"]) == (2, 20, 2.0)
    assert speed.line("gradient", 32, 3, run, 0.5)["steps"] is None
    falling = list(10.0 * 0.8 ** np.arange(80))
    assert not speed.is_steady(falling[:40]) and speed.is_steady(falling)


def test_the_plain_settings_come_first() -> None:
    for fixed, grid in tuned.GRIDS.values():
        first = tuned.choices(grid)[0]
        assert not any(first.get(key) for key in ("smoothness", "presmooth", "diffusion")), fixed
    assert len(tuned.choices({"a": [1, 2], "b": [3, 4, 5]})) == 6


@pytest.mark.parametrize("dim", [2, 3])
def test_the_problem_is_the_same_on_every_grid(dim: int) -> None:
    volumes = []
    for n in (32, 48):
        surface, energy = speed.problem(n, dim)
        part, _ = surface.fraction_and_area()
        volumes.append(surface.volume(part) / (surface.grid.hz if dim == 2 else 1.0))
        assert energy.alpha == speed.ALPHA
    assert volumes[0] == pytest.approx(volumes[1], rel=0.01)
