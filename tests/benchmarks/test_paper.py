"""The page on the paper: landscapes, the vector form of the Sobolev gradient, what counts as trapped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelsurf.levelset import LevelSet
from benchmarks import pages
from benchmarks.paper import landscapes, tables
from benchmarks.paper.experiments import EXPERIMENTS
from benchmarks.paper.runs import METHODS, SMEARED, Task, ridge, run, vector_gradient


@pytest.mark.parametrize("name", landscapes.ALL)
def test_a_seed_makes_the_same_landscape_and_starts_touch_the_object(name: str) -> None:
    landscape = landscapes.ALL[name]
    image, truth = landscape.make(3)
    again, _ = landscape.make(3)
    assert np.array_equal(image, again) and not np.array_equal(image, landscape.make(4)[0])
    assert 0.02 < truth.mean() < 0.3 and image[truth].mean() - image[~truth].mean() > 0.3
    for start, ball in landscape.starts.items():
        inside = ball.distance() < 0
        assert inside.sum() > 200 and (start == "around" or truth[inside].mean() > 0.5)


def test_every_task_has_its_start_and_method() -> None:
    for name, tasks in EXPERIMENTS.items():
        assert len({task.seed for task in tasks}) >= 5 and len(set(tasks)) == len(tasks)
        for task in tasks:
            assert task.experiment == name and task.method in METHODS
            assert task.start in landscapes.ALL[task.landscape].starts


@pytest.mark.parametrize("length", [5.0, 10.0])
def test_the_vector_form_keeps_a_third_of_a_translation(length: float) -> None:
    z, y, x = np.indices((32, 32, 32)) - 15.5
    surface = LevelSet(np.sqrt(z**2 + y**2 + x**2) - 10.0, (1.0, 1.0, 1.0))
    force = -surface.normals()[:, 0]
    found = vector_gradient(surface, force, length, np.zeros(surface.size, np.float32))
    near = surface.front(1.0)
    factor = float((found * force)[near].sum() / (force * force)[near].sum())
    assert factor == pytest.approx(1 / 3 + 2 / 3 / (1 + 6 * (length / 10.0) ** 2), rel=0.03)


def test_a_run_reports_its_plateau() -> None:
    figures = run(Task("several phases", "several phases", "inside", "descent", 0))
    assert figures["stop"] == "converged" and figures["seconds"] > 0
    assert figures["dice"] < 0.2 and figures["later_dice"] == pytest.approx(
        figures["dice"], abs=0.01
    )
    assert figures["first_energy"] > figures["energy"] > figures["true_energy"]


@pytest.mark.parametrize(
    ("core", "epsilon", "rise"),
    [("core 2.4", 0.0, 135), ("core 2.4", SMEARED, 0), ("core 2.6", SMEARED, 109)],
)
def test_the_ridge_is_that_of_the_energy_that_is_minimised(
    core: str, epsilon: float, rise: float
) -> None:
    found = ridge(Task("ridge", core, "inside", "descent", 0, epsilon=epsilon))
    assert found["crest"] - found["least"] == pytest.approx(rise, abs=2)
    assert found["first_energy"] > found["crest"] > found["true_energy"]


def test_energies_of_runs_have_the_interface_of_their_task() -> None:
    """Descent rests at a core of 2.4 with a sharp interface, and not with the program's."""
    task = Task("cores", "core 2.4", "inside", "descent", 0)
    assert run(task)["dice"] < 0.2
    assert run(task._replace(epsilon=SMEARED))["dice"] > 0.99


@pytest.mark.parametrize(
    ("dice", "later", "energy", "steps", "words"),
    [
        (0.5, 0.5, 3.0, 100, "trapped"),
        (0.5, 0.6, 3.0, 100, "stopped on its way"),
        (0.5, 0.5, 1.0, 100, "rougher, lower energy"),
        (0.89, 0.89, 3.0, 200, "slow"),
        (0.89, 0.89, 3.0, 100, "the same"),
        (0.95, 0.95, 3.0, 100, "momentum worse"),
    ],
)
def test_what_descent_is_beside_momentum(
    dice: float, later: float, energy: float, steps: int, words: str
) -> None:
    momentum: dict[str, Any] = {"dice": 0.9, "later_dice": 0.9, "energy": 2.0, "steps": 100}
    descent = {"dice": dice, "later_dice": later, "energy": energy, "steps": steps}
    assert tables.verdict(descent, momentum) == words


def test_a_page_keeps_what_follows_a_table(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    heads = [f"<!-- python -m benchmarks.paper {name} writes this table -->" for name in "ab"]
    page.write_text("".join(f"{head}\n{pages.END}\nafter\n" for head in heads))
    for name in ("a", "b", "a"):
        pages.put_table(page, name, f"table {name}", tables.COMMAND)
    text = page.read_text()
    assert text.count("after") == 2 and text.index("table a") < text.index("after") < text.index(
        "table b"
    )
