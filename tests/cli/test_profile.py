"""Where the seconds of a run went: stages that add up to the total, and that every kernel names itself."""

import ast
import importlib
import pkgutil
from pathlib import Path

import numpy as np
import pytest

import accelsurf
from accelsurf import kernels
from accelsurf.cli import segment
from accelsurf.clicks import kernels as click_kernels
from accelsurf.image import kernels as image_kernels
from accelsurf.kernels._jit import STAGE_OF_KERNEL, Stage

ROOMS = (kernels, image_kernels, click_kernels)
MODULES = {
    one.name.rsplit(".", 1)[1]: importlib.import_module(one.name)
    for room in ROOMS
    for one in pkgutil.walk_packages(room.__path__, f"{room.__name__}.")
}


@pytest.mark.sampled
@pytest.mark.parametrize(
    "parts", [(), ("load",), ("load", "start", "evolve", "mesh", "write"), ("evolve", "write")]
)
@pytest.mark.parametrize(
    "names",
    [
        (),
        ("find_closest_points", "kick"),
        ("find_closest_points", "classify_closest_points", "kick", "not_known_here"),
    ],
)
def test_stages_add_up_to_the_total(parts, names):
    rng = np.random.default_rng(len(parts) + len(names))
    seconds = {part: float(rng.uniform(5, 9)) for part in parts} | {"total": 60.0}
    spent_in = {name: float(rng.uniform(0.1, 1)) for name in names}
    stages = segment.seconds_by_stage(seconds, spent_in)
    assert sum(value for _, value in stages) == pytest.approx(60)
    assert len({stage for stage, _ in stages}) == len(stages)
    found = dict(stages)
    closest_points = sum(
        spent_in.get(name, 0) for name in ("find_closest_points", "classify_closest_points")
    )
    assert found.get("other kernels", 0) == spent_in.get("not_known_here", 0)
    assert found.get("closest points", 0) == pytest.approx(closest_points)
    if "evolve" in parts:
        assert found["evolve: other"] == pytest.approx(seconds["evolve"] - sum(spent_in.values()))
    for part in parts:
        assert part == "evolve" or found[part] == seconds[part]
    assert len(segment.profile_lines(seconds, spent_in)) == len(stages)


def kernels_handed_over(path):
    """Names of kernels, ``module.kernel``, that a file gives to a call as an argument, as `Workers` is given them."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    aliases = {
        (name.asname or name.name): name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in {room.__name__ for room in ROOMS}
        for name in node.names
    }
    given = [arg for node in ast.walk(tree) if isinstance(node, ast.Call) for arg in node.args]
    return {
        (aliases[arg.value.id], arg.attr)
        for arg in given
        if isinstance(arg, ast.Attribute)
        and isinstance(arg.value, ast.Name)
        and arg.value.id in aliases
        if callable(getattr(MODULES[aliases[arg.value.id]], arg.attr))
    }


def test_every_kernel_that_workers_are_given_has_a_stage():
    folder = Path(accelsurf.__file__).parent
    used = set().union(*(kernels_handed_over(path) for path in folder.rglob("*.py")))
    assert len(used) > 45
    assert sorted(name for _, name in used if name not in STAGE_OF_KERNEL) == []
    # No stage is left over from a kernel that is gone, and none is said in vain.
    assert sorted(set(STAGE_OF_KERNEL) - {name for _, name in used}) == []
    assert set(STAGE_OF_KERNEL.values()) == set(Stage)


def test_what_a_run_counts_has_a_stage():
    surface = accelsurf.levelset.LevelSet(
        np.linalg.norm(np.indices((9, 9, 9)) - 4.0, axis=0) - 3, (1, 1, 1)
    )
    surface.curvature(surface.front())
    assert len(surface.workers.seconds) > 10
    assert set(surface.workers.seconds) <= set(STAGE_OF_KERNEL)


def test_one_name_has_one_stage():
    def kick():
        """As a kernel of the flows is called."""

    with pytest.raises(
        ValueError, match="kernel kick has stage Stage.FLOW elsewhere, Stage.BAND was given"
    ):
        kernels._jit.kernel(stage=Stage.BAND)(kick)
