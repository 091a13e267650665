"""accelsurf warmup: after it nothing is compiled any more."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from accelsurf import cli, io
from accelsurf.kernels import storage
from accelsurf.phantoms import recipes
from accelsurf.segmentation import warmup

PACKAGE = Path(cli.__file__).parents[1]

#: Makes all small runs, and prints the kernels that were called, by the name of their module and their own.
CODE = """
import gc, json
from numba.core.dispatcher import Dispatcher
from accelsurf.segmentation.warmup import small_runs

for run in small_runs().values():
    run()
called = [one for one in gc.get_objects() if isinstance(one, Dispatcher) and one.signatures]
print(json.dumps([f"{one.__module__}.{one.__name__}" for one in called]))
"""


def is_kernel(node):
    """Whether a definition has the decorator `kernel`."""
    if not isinstance(node, ast.FunctionDef):
        return False
    names = [one.func if isinstance(one, ast.Call) else one for one in node.decorator_list]
    return any(isinstance(name, ast.Name) and name.id == "kernel" for name in names)


def called_kernels():
    """Kernels that modules outside of accelsurf.kernels name, by import or as an attribute of their module."""
    defined = {
        f"accelsurf.{'.'.join(path.relative_to(PACKAGE).with_suffix('').parts)}.{node.name}"
        for path in (PACKAGE / "kernels").rglob("*.py")
        for node in ast.parse(path.read_text()).body
        if is_kernel(node)
    }
    found = set()
    for path in PACKAGE.rglob("*.py"):
        if "kernels" in path.relative_to(PACKAGE).parts or path.name == "checks.py":  # checks are made by tests only
            continue
        names = {}
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                names |= {one.asname or one.name: f"{node.module}.{one.name}" for one in node.names}
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                found.add(f"{names.get(node.value.id)}.{node.attr}")
        found |= set(names.values())
    return found & defined


def test_the_small_runs_call_every_kernel_that_python_calls():
    # Strict where the kernels are stored already: one that is compiled into another counts as called otherwise.
    expected = called_kernels()
    assert len(expected) > 50
    ended = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert not expected - set(json.loads(ended.stdout.splitlines()[-1]))


def test_it_says_how_many_were_compiled_and_where_they_are(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(storage, "STORAGE", tmp_path)
    (tmp_path / "old.nbc").touch()
    monkeypatch.setattr(warmup, "small_runs", lambda: {"one": (tmp_path / "new.nbc").touch, "two": list})
    assert cli.execute(["warmup"]) == 0
    out = capsys.readouterr().out
    assert "1 kernels compiled and stored, 1 were there" in out and str(tmp_path) in out and "two" in out
    assert cli.execute(["warmup", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_without_a_folder_it_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(storage, "STORAGE", None)
    monkeypatch.setattr(warmup, "small_runs", lambda: {"one": pytest.fail})
    assert cli.execute(["warmup"]) == 7
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_after_it_no_command_compiles(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}

    def compiled_by(*words):
        subprocess.run(
            [sys.executable, "-m", "accelsurf", *map(str, words)], env=environment, check=True, capture_output=True
        )
        return {path.name for path in (tmp_path / "kernels").rglob("*.nbc")}

    stored = compiled_by("warmup")
    assert len(stored) > 100
    io.write(recipes.make(recipes.load_recipe("cube_noisy")).image, tmp_path / "cube.nii.gz")
    out = tmp_path / "out"
    for words in (
        ("segment", tmp_path / "cube.nii.gz", "-o", out, "--start", "ball:2,1,-1,10", "--max-steps", "30"),
        ("segment", tmp_path / "cube.nii.gz", "-o", out, "--inside", "point:0,0,0", "--max-steps", "30", "--overwrite"),
        ("refine", out, "--outside", "point:35,0,0"),
    ):
        assert compiled_by(*words) == stored
