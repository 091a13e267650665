"""Where the seconds of a run went: stages that add up to the total."""

import importlib
import pkgutil

import numpy as np
import pytest

from accelsurf import kernels
from accelsurf.cli import profile


@pytest.mark.parametrize("parts", [(), ("load",), ("load", "start", "evolve", "mesh", "write"), ("evolve", "write")])
@pytest.mark.parametrize("names", [(), ("find_feet", "kick"), ("find_feet", "spread", "drift", "not_known_here")])
def test_stages_add_up_to_the_total(parts, names):
    rng = np.random.default_rng(len(parts) + len(names))
    seconds = {part: float(rng.uniform(5, 9)) for part in parts} | {"total": 60.0}
    spent_in = {name: float(rng.uniform(0.1, 1)) for name in names}
    stages = profile.spent(seconds, spent_in)
    assert sum(value for _, value in stages) == pytest.approx(60)
    assert len({stage for stage, _ in stages}) == len(stages)
    found = dict(stages)
    assert found.get("other kernels", 0) == spent_in.get("not_known_here", 0)
    assert found.get("closest points", 0) == pytest.approx(sum(spent_in.get(k, 0) for k in ("find_feet", "spread")))
    if "evolve" in parts:
        assert found["evolve: other"] == pytest.approx(seconds["evolve"] - sum(spent_in.values()))
    for part in parts:
        assert part == "evolve" or found[part] == seconds[part]
    assert len(profile.lines(seconds, spent_in)) == len(stages)


def test_every_kernel_of_a_stage_exists_and_is_in_one_stage_only():
    found = pkgutil.walk_packages(kernels.__path__, "accelsurf.kernels.")
    modules = [importlib.import_module(one.name) for one in found]
    names = [name for stage in profile.STAGES.values() for name in stage]
    assert len(set(names)) == len(names)
    assert [name for name in names if not any(hasattr(module, name) for module in modules)] == []
