"""Runs over several levels: the same result for less, one history, and what happens where a grid is too coarse."""

import json

import numpy as np
import pytest

from accelsurf.api.segment import evolve, segment
from accelsurf.cli import execute
from accelsurf.errors import UsageError
from accelsurf.evolution import multilevel
from accelsurf.evolution.convergence import StopRule
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import StepLimits
from accelsurf.image.volume import Volume
from accelsurf.io import write
from accelsurf.levelset import LevelSet
from accelsurf.measure.metrics import dice
from accelsurf.phantoms.recipes import make, recipe_from
from accelsurf.run.energy import make_energy
from accelsurf.run.setup import half_width, make_flow
from accelsurf.text.starts import psi_of_starts, read_starts

NOISY = {
    "kind": "cube",
    "shape": [64, 64, 64],
    "spacing": [1.0, 1.0, 1.0],
    "side": 32.0,
    "noise": 0.6,
    "seed": 3,
}
START = {"start": "ball:5,-4,4,9"}


@pytest.fixture(scope="module")
def cube():
    return make(recipe_from(NOISY))


def cost(result, level=0):
    return sum(row.cells_visited for row in result.history if row.level == level)


def disk(n=96):
    y, x = np.indices((n, n + 7))
    inside = (y - 50) ** 2 + (x - 45) ** 2 < 30**2
    return inside, inside * 1.0 + np.random.default_rng(1).normal(0, 0.5, inside.shape)


# ----------------------------------------------------------------------------------------------------- what it gives


SLOW = pytest.param("flowable-mass", marks=pytest.mark.slow)  # half a minute


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["constant-density", SLOW, "gradient", "sobolev", "momentum"])
def test_the_same_surface_for_less(cube, flow):
    options = {**START, "flow": flow, "smoothness": 0.05}
    one, two = (segment(cube.image, levels=levels, **options) for levels in (1, 2))
    truth = cube.truth.array
    assert two.stop.reason == "converged"
    # Descent is caught by noise on the fine grid: there the pyramid does better, not the same.
    assert dice(two.labels, truth) > dice(one.labels, truth) - 0.002
    assert cost(two) < cost(one) and cost(two, 1) < 0.3 * cost(one)


def test_one_energy_budget(cube):
    steps = []
    result = segment(cube.image, levels=2, on_step=steps.append, **START)
    history = result.history
    assert steps == history and [row.step for row in history] == list(range(len(history)))
    levels = [row.level for row in history]
    assert levels == sorted(levels, reverse=True) and set(levels) == {0, 1}
    times = [row.t for row in history]
    assert times == pytest.approx(
        np.concatenate(([0.0], np.cumsum([row.dt for row in history])))[:-1]
    )
    # Only the very last row has no step.
    assert all(row.dt > 0 for row in history[:-1]) and history[-1].dt == 0
    assert result.stop.steps == len(history) - 1
    coarse, fine = result.levels
    assert (coarse.level.number, fine.level.number) == (1, 0)
    assert coarse.steps == levels.count(1) and fine.steps == levels.count(0) - 1
    assert coarse.reason == "converged" and fine.reason == result.stop.reason
    # Volume and area go on where they were.
    last, first = (
        [row for row in history if row.level][-1],
        next(row for row in history if not row.level),
    )
    assert first.volume_mm3 == pytest.approx(last.volume_mm3, rel=0.02)
    assert first.area_mm2 == pytest.approx(last.area_mm2, rel=0.05)


def test_the_account_of_the_energy_goes_on(cube):
    history = segment(cube.image, levels=2, smoothness=0.3, presmooth=1.5, **START).history
    total = np.array(
        [
            row.potential + row.kinetic / row.weight + row.friction_work + row.smoothing_work
            for row in history[:-1]
        ]
    )
    change = next(row.step for row in history if row.level == 0)
    won = history[0].potential - min(row.potential for row in history if row.level == 1)
    assert abs(total[change] - total[change - 1]) < 0.02 * won


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["constant-density", "flowable-mass"])
def test_momentum_goes_on(cube, flow, monkeypatch):
    # The coarse level ends in full motion. The weight of k = 3 tells the time on the clock of w and gamma.
    for name, value in (
        ("COARSE_WINDOW", 8),
        ("COARSE_MOTION", 1e9),
        ("COARSE_KINETIC", 1e9),
        ("COARSE_FAR", 1.0),
    ):
        monkeypatch.setattr(multilevel, name, value)
    options = {**START, "presmooth": 2.0, "restart": "off", "max_steps": 24, "flow": f"{flow}:k=3"}
    rows = segment(cube.image, levels=2, **options).history
    change = next(row.step for row in rows if row.level == 0)
    assert change == 8
    # The history's kinetic energy is that at the step's beginning, which both levels know but for the resampling.
    trend = rows[change - 1].kinetic * (rows[change - 1].kinetic / rows[change - 2].kinetic)
    assert rows[change].kinetic == pytest.approx(trend, rel=0.3)
    assert rows[change].t == pytest.approx(rows[change - 1].t + rows[change - 1].dt)
    weights = [row.weight for row in rows[1:-1]]
    assert weights == sorted(weights) and weights[change] > weights[2] > 0
    if flow == "flowable-mass":
        assert rows[change].mass == pytest.approx(rows[change - 1].mass)


def test_steps_have_the_grid_of_their_level(cube):
    shapes = {
        step.record.level: step.surface.shape for step in evolve(cube.image, levels=2, **START)
    }
    assert shapes == {1: (32, 32, 32), 0: (64, 64, 64)}


def test_the_steps_of_all_levels_count(cube):
    result = segment(cube.image, levels=2, max_steps=7, **START)
    assert result.stop.reason == "max-steps" and result.stop.steps == 7
    assert [p.reason for p in result.levels] == ["max-steps", "max-steps"]
    assert result.labels.shape == (64, 64, 64) and result.labels.any()


def test_a_run_that_is_stopped_on_a_coarse_level_still_has_a_result(cube):
    result = segment(cube.image, levels=3, on_step=lambda row: row.step == 3, **START)
    assert result.stop.reason == "interrupted" and result.stop.steps == 4
    assert result.psi.shape == (64, 64, 64) and result.labels.sum() > 1000


@pytest.mark.slow
@pytest.mark.threads
def test_the_same_bytes_for_any_number_of_threads(cube):
    runs = [segment(cube.image, levels=2, threads=threads, **START) for threads in (1, 1, 2, 3)]
    for other in runs[1:]:
        assert other.psi.tobytes() == runs[0].psi.tobytes()
        assert [row.potential for row in other.history] == [
            row.potential for row in runs[0].history
        ]


def test_one_level_is_the_plain_evolution(cube):
    result = segment(cube.image, levels=1, max_steps=30, flow="constant-density", **START)
    config, image = result.config, result.image
    surface = LevelSet(
        psi_of_starts(read_starts(config.start), cube.image), (1.0, 1.0, 1.0), half_width(config)
    )
    plain = Evolution(
        surface,
        make_energy(config, image, (1.0, 1.0, 1.0)).energy,
        SolverSetup(make_flow(config), StepLimits(0.5, 95.0), rule=StopRule()),
        30,
    )
    for _ in plain:
        pass
    assert plain.surface.psi.tobytes() == result.psi.tobytes()
    assert [row.potential for row in plain.history] == [row.potential for row in result.history]
    assert result.warnings == [] and [p.level.number for p in result.levels] == [0]


def test_thick_slices_and_odd_sizes():
    grid = {"shape": [81, 75, 27], "spacing": [1.0, 1.0, 2.7]}
    phantom = make(recipe_from({"kind": "ball", **grid, "radius": 26.3, "antialias": True}))
    result = segment(phantom.image, start="ball:8,6,-4,12", levels=2, epsilon=0)
    assert [p.level.spacing for p in result.levels] == [(2.7, 2.0, 2.0), (2.7, 1.0, 1.0)]
    assert dice(result.labels, phantom.truth.array) > 0.995


def test_a_slice():
    inside, image = disk()
    one, auto = (
        segment(image, start="ball:40,55,0,12vox", levels=levels) for levels in (1, "auto")
    )
    assert [p.level.shape for p in auto.levels] == [(1, 24, 26), (1, 48, 52), (1, 96, 103)]
    assert dice(auto.labels[0], inside) > dice(one.labels[0], inside) - 0.002
    assert auto.start is not None and auto.start.shape == (1, 96, 103)
    assert auto.length_mm == pytest.approx(one.length_mm, rel=0.05)


# ------------------------------------------------------------------------------------------------- how many, and when


def test_auto_takes_what_resolves_image_and_start(cube):
    def levels(image, start, **options):
        return len(segment(image, start=start, max_steps=1, **options).levels)

    assert levels(cube.image, "ball:5,-4,4,9") == 2
    assert levels(cube.image, "ball:5,-4,4,4") == 1
    # One part of the start is small, though the other is not.
    assert levels(cube.image, ("ball:5,-4,4,9", "ball:-20,-20,-20,3")) == 1
    assert levels(np.asarray(cube.image.array)[:40, :40, :40], "ball:20,20,20,9vox") == 1
    assert levels(cube.image, "ball:5,-4,4,9", energy="geodesic") == 1


def test_more_levels_than_the_image_has_are_refused(cube):
    with pytest.raises(UsageError, match="levels: 9 was given, expected at most 4"):
        segment(cube.image, levels=9, **START)
    with pytest.raises(UsageError, match="levels: 0 was given"):
        segment(cube.image, levels=0, **START)


# ---------------------------------------------------------------------------------------- where a coarse grid fails


def test_what_vanishes_on_a_coarse_level_begins_anew_on_the_next():
    """A rod of two voxels: averaged there is little left of it but grey."""
    z, y, x = np.indices((64, 64, 64))
    rod = (np.abs(z - 31.5) < 1.1) & (np.abs(y - 31.5) < 1.1)
    image = 1.0 * rod
    options = {"start": "box:24,30,30,40,33,33vox", "smoothness": 0.15, "epsilon": 0}
    one, three = (segment(image, levels=levels, **options) for levels in (1, 3))
    assert one.labels.any() and three.stop.reason == one.stop.reason
    assert any("vanished" in w or "shrank" in w or "not resolved" in w for w in three.warnings)
    assert dice(three.labels, one.labels) > 0.99
    assert three.report["warnings"] == three.warnings


def test_a_start_that_no_coarse_voxel_sees(cube):
    result = segment(cube.image, start="ball:0.5,0.5,0.5,2.6", levels=4, max_steps=3)
    assert result.warnings and "the start is not resolved there" in result.warnings[0]
    assert result.levels[0].steps == 0 and result.levels[0].reason is None


# --------------------------------------------------------------------------------------------- command line, report


@pytest.mark.slow
def test_levels_on_the_command_line_and_in_the_report(cube, tmp_path, capsys):
    write(Volume(cube.image.array, cube.image.geometry), tmp_path / "cube.nii.gz")
    call = [
        "segment",
        str(tmp_path / "cube.nii.gz"),
        "-o",
        str(tmp_path / "out"),
        "--start",
        START["start"],
    ]
    assert execute([*call, "--levels", "2"]) == 0
    assert "steps on 2 levels" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "cube_report.json").read_text())
    assert report["config"]["levels"] == 2
    assert [entry["level"] for entry in report["levels"]] == [1, 0]
    assert [entry["size"] for entry in report["levels"]] == [[32, 32, 32], [64, 64, 64]]
    assert [entry["spacing"] for entry in report["levels"]] == [[2.0, 2.0, 2.0], [1.0, 1.0, 1.0]]
    assert sum(entry["steps"] for entry in report["levels"]) == report["stop"]["steps"]
    assert (tmp_path / "out" / "cube_trace.csv").read_text().startswith("step,level,t,")
    assert execute([*call, "--levels", "none", "--overwrite"]) == 2
    assert (
        "levels: none was given, expected a whole number at least 1 or auto"
        in capsys.readouterr().err
    )
