"""The page of the method alone: its script runs, finds the object, and loads the rooms of the method alone."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "method.md"
ROOMS = {
    "errors",
    "version",
    "kernels",
    "grid",
    "levelset",
    "flows",
    "energies",
    "evolution",
}
LOADED = """
import json, sys
print(json.dumps([name.split(".")[1] for name in sys.modules if name.startswith("accelsurf.")]))
"""


@pytest.fixture(scope="module")
def script():
    (found,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return found


def test_the_script_has_sixty_lines_at_most(script):
    assert len(script.splitlines()) <= 60


def test_the_script_evolves_a_ball_onto_the_image(script, capsys):
    names = {}
    exec(compile(script, str(PAGE), "exec"), names)
    assert names["evolution"].stop.reason == "converged"
    assert names["dice"] > 0.97
    assert names["last"].volume_mm3 == pytest.approx(names["exact"], rel=0.03)
    assert names["taken"] == pytest.approx(names["lost"], rel=0.1)
    assert names["last"].potential < names["first"].potential
    assert np.isfinite([record.potential for record in names["evolution"].history]).all()
    assert "converged after" in capsys.readouterr().out


def test_the_script_loads_the_method_alone(script):
    imports = script.split("# Arrays are")[0]
    ended = subprocess.run(
        [sys.executable, "-c", imports + LOADED], capture_output=True, text=True, check=True
    )
    assert set(json.loads(ended.stdout.splitlines()[-1])) <= ROOMS
