"""accelsurf warmup: after it nothing is compiled any more."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cli import warmup
from accelsurf.image.volume import Volume
from accelsurf.kernels import storage
from accelsurf.phantoms import recipes
from accelsurf.settings.flow_specs import FLOWS

pytestmark = pytest.mark.program

PACKAGE = Path(cli.__file__).parents[1]

#: Makes all small runs, and prints the kernels that were called, by the name of their module and their own.
CODE = """
import gc, json
from numba.core.dispatcher import Dispatcher
from accelsurf.cli.warmup import small_runs

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
    """Kernels that modules which are none name, by import or as an attribute of their module."""
    defined = {
        f"accelsurf.{'.'.join(path.relative_to(PACKAGE).with_suffix('').parts)}.{node.name}"
        for path in storage.kernel_files()
        for node in ast.parse(path.read_text()).body
        if is_kernel(node)
    }
    found = set()
    for path in PACKAGE.rglob("*.py"):
        if "kernels" in path.relative_to(PACKAGE).parts:
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
    monkeypatch.setattr(
        warmup, "small_runs", lambda: {"one": (tmp_path / "new.nbc").touch, "two": list}
    )
    assert cli.execute(["warmup"]) == 0
    out, err = capsys.readouterr()
    assert "1 kernels compiled and stored, 1 kernels were stored" in out and str(tmp_path) in out
    assert "compiling" in err
    assert warmup.is_complete()
    assert cli.execute(["warmup"]) == 0
    out, err = capsys.readouterr()
    assert "nothing to compile, 2 kernels were stored already" in out and "compiling" not in err
    assert cli.execute(["warmup", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_without_a_folder_it_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(storage, "STORAGE", None)
    monkeypatch.setattr(warmup, "small_runs", lambda: {"one": pytest.fail})
    assert cli.execute(["warmup"]) == 7
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().err


#: Runs each command in one process, and prints the kernels that it stored, by the number of the command.
RUNS = """
import json, sys
from accelsurf import cli
from accelsurf.kernels import storage

found, before = {}, storage.stored()
for number, words in enumerate(json.loads(sys.argv[1])):
    code = cli.execute(words)
    assert code == 0, (code, words)
    found[" ".join(words)] = sorted(storage.stored() - before)
    before = storage.stored()
print(json.dumps({words: new for words, new in found.items() if new}))
"""


def representative_commands(folder):
    """Write images of several types, and return commands for each way of running that compiled code belongs to."""
    z, y, x = np.indices((24, 28, 32))
    ball = (z - 12) ** 2 * 2.25 + (y - 14) ** 2 + (x - 16) ** 2 < 9**2
    grey = 100 * ball + np.random.default_rng(0).normal(50, 8, ball.shape)
    starts = np.zeros(ball.shape, np.uint8)
    starts[10:15, 12:17, 10:14], starts[10:15, 12:17, 18:22] = 2, 6
    for name, values in (
        ("f.nii.gz", grey.astype(np.float32)),
        ("t.nii.gz", ball.astype(np.uint8)),
        ("l.nii.gz", starts),
        ("i.ome.zarr", grey.astype(np.int16)),
        ("u.ome.zarr", grey.astype(np.uint16)),
        ("b.nii.gz", np.clip(grey, 0, 255).astype(np.uint8)),
        ("c.tif", np.clip(grey[12:13], 0, 255).astype(np.uint8)),
    ):
        io.write(
            Volume.from_array(values, (1.0, 1.0, 1.0) if name == "c.tif" else (1.5, 1.0, 1.0)),
            folder / name,
        )
    (folder / "balls.csv").write_text("id,x,y,z,r\n1,12,14,18,4\n2,20,14,18,4\n")
    ball, flat, few = (
        "--start ball:16,14,12,5vox",
        "--start ball:16,14,0,5vox",
        "--max-steps 12 --quiet",
    )
    lines = [
        f"f.nii.gz {ball}",
        f"b.nii.gz {ball}",
        "f.nii.gz --start otsu --levels 2",
        f"c.tif {flat}",
        "f.nii.gz --start label:t.nii.gz",
        "f.nii.gz --start seed:16,14,12,4vox",
        "f.nii.gz --inside point:16,14,18",
        "f.nii.gz --inside label:l.nii.gz@2",
        "c.tif --inside point:16,14,0",
        "f.nii.gz --inside point:16,14,18 --outside point:29,14,18",
        "f.nii.gz --objects l.nii.gz",
        "f.nii.gz --inside point:16,14,18 --outside point:29,14,18 --energy partition",
        "f.nii.gz --objects balls.csv --extension fast-marching",
        f"f.nii.gz --channel b.nii.gz {ball}",
        f"f.nii.gz {ball} --noise 0.2 --seed 1",
        f"i.ome.zarr {ball} --max-memory 600MiB",
        *(f"{name}.ome.zarr --objects balls.csv --jobs 1" for name in "iu"),
        *(f"f.nii.gz {ball} --flow {flow}" for flow in FLOWS),
        *(f"c.tif {flat} --flow {flow}" for flow in FLOWS),
        *(
            f"f.nii.gz {ball} --energy {term}"
            for term in ("local-region", "geodesic", "likelihood")
        ),
    ]
    commands = [f"segment {line} -o out{number} {few}" for number, line in enumerate(lines)]
    commands.insert(1, f"segment f.nii.gz --start mesh:out0/f_surface.ply -o outm {few}")
    commands += [
        "refine out6 --outside point:16,24,18 --quiet",
        "refine out8 --inside point:16,20,0 --quiet",
        "evaluate out0/f_seg.nii.gz t.nii.gz --labels all --tolerance 1",
    ]
    return [command.split() for command in commands]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_after_it_no_way_of_running_compiles(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    subprocess.run(
        [sys.executable, "-m", "accelsurf", "warmup", "--quiet"], env=environment, check=True
    )
    words = json.dumps(representative_commands(tmp_path))
    done = subprocess.run(
        [sys.executable, "-c", RUNS, words],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_after_it_no_command_compiles(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}

    def compiled_by(*words):
        subprocess.run(
            [sys.executable, "-m", "accelsurf", *map(str, words)],
            env=environment,
            check=True,
            capture_output=True,
        )
        return {path.name for path in (tmp_path / "kernels").rglob("*.nbc")}

    stored = compiled_by("warmup")
    assert len(stored) > 100
    io.write(recipes.make(recipes.load_recipe("cube_noisy")).image, tmp_path / "cube.nii.gz")
    out = tmp_path / "out"
    for words in (
        (
            "segment",
            tmp_path / "cube.nii.gz",
            "-o",
            out,
            "--start",
            "ball:2,1,-1,10",
            "--max-steps",
            "30",
        ),
        (
            "segment",
            tmp_path / "cube.nii.gz",
            "-o",
            out,
            "--inside",
            "point:0,0,0",
            "--max-steps",
            "30",
            "--overwrite",
        ),
        ("refine", out, "--outside", "point:35,0,0"),
    ):
        assert compiled_by(*words) == stored
