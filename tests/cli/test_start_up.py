"""What a command loads before it begins: nothing that it does not need. Counted, as seconds depend on the machine."""

import json
import os
import subprocess
import sys

import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.phantoms import recipes

pytestmark = pytest.mark.program

#: What only a run needs: compiled code, numerics, readers of images, drawing.
OF_A_RUN = {"numba", "scipy", "skimage", "SimpleITK", "nibabel", "PIL"}
#: What only studies, other formats and the viewer need.
OF_OTHERS = {
    "matplotlib",
    "pandas",
    "pyvista",
    "vtkmodules",
    "trame",
    "trimesh",
    "IPython",
    "pytest",
}
#: What reads DICOM, and what that imports; nibabel would import it for every NIfTI.
OF_DICOM = {"pydicom", "highdicom", "requests", "urllib3"}
#: Kernels that a run calls, each loaded from the disk in 3 ms: 49 and 55 when this was written.
MOST_KERNELS = {"start": 49, "inside": 55}

#: Runs a command; prints its exit code, the modules that it loaded, and the kernels that were compiled or loaded.
CODE = """
import json, sys
from accelsurf.cli import execute
code = execute(sys.argv[1:])
numba = sys.modules.get("numba")
kernels = []
if numba is not None:
    import gc
    for one in gc.get_objects():
        if isinstance(one, numba.core.dispatcher.Dispatcher) and one.__module__.startswith("accelsurf"):
            name = f"{one.__module__.removeprefix('accelsurf.kernels.')}.{one.__name__}"
            kernels += [f"{name}: {types}" for types in one.stats.cache_hits]
print(json.dumps([code, sorted(sys.modules), kernels]))
"""


def loaded(*words):
    """Exit code of a command in a process of its own, modules that it loaded, and kernels that it called."""
    ended = subprocess.run(
        [sys.executable, "-c", CODE, *map(str, words)], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    code, modules, kernels = json.loads(ended.stdout.splitlines()[-1])
    return code, set(modules), kernels


def packages_of(modules):
    return {name.partition(".")[0] for name in modules}


@pytest.fixture
def ball(tmp_path):
    io.write(recipes.make(recipes.load_recipe("ball_small")).image, tmp_path / "ball.nii.gz")
    return tmp_path / "ball.nii.gz"


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--version",), 0),
        (("segment", "--help"), 0),
        (("segment", "FOLDER/absent.nii.gz", "-o", "FOLDER/out"), 3),
        (("segment", "FOLDER/ball.nii.gz", "-o", "FOLDER/out", "--cfl", "7"), 2),
        (("segment", "FOLDER/ball.nii.gz"), 2),
        (("look", "FOLDER/absent.nii.gz"), 3),
        (("batch", "--help"), 0),
        (("batch", "FOLDER/absent", "-o", "FOLDER/out"), 3),
        (("batch", "FOLDER", "-o", "FOLDER/out", "--shard", "2/1"), 2),
        (("refine", "FOLDER/absent", "--inside", "point:0,0,0"), 3),
        (("evaluate", "FOLDER/absent.nii.gz"), 2),
        (("evaluate", "--pairs", "FOLDER/absent.csv"), 3),
        (("--install-completion", "-o", "FOLDER/script", "--shell", "bash"), 0),
    ],
)
def test_what_is_refused_or_told_at_once_loads_nothing_of_a_run(words, code, ball):
    words = [word.replace("FOLDER", str(ball.parent)) for word in words]
    got, modules, _ = loaded(*words)
    assert got == code
    assert not packages_of(modules) & (OF_A_RUN | OF_OTHERS)


def test_a_look_at_an_image_does_without_compiled_code_and_numerics(ball):
    code, modules, _ = loaded("look", ball, "-o", ball.parent / "look.png")
    assert code == 0
    # nibabel loads scipy's first module to see whether it is there, which takes 5 ms.
    assert not modules & {
        "numba",
        "skimage",
        "scipy.ndimage",
        "scipy.special",
        "scipy.spatial",
        "scipy.linalg",
    }
    assert not packages_of(modules) & (OF_OTHERS - {"matplotlib"} | OF_DICOM)
    assert "matplotlib.pyplot" not in modules


def test_pydicom_is_there_for_all_but_nibabel_s_import(ball):
    code = (
        "import sys; from pathlib import Path; from accelsurf.io.formats.nifti import import_nibabel_for\n"
        f"import_nibabel_for(Path({__file__!r})); print('nibabel' in sys.modules)\n"
        f"import_nibabel_for(Path({str(ball)!r})); print('nibabel' in sys.modules, 'pydicom' in sys.modules)\n"
        "from nibabel.nicom import csareader; import pydicom; print(csareader.get_csa_header(pydicom.Dataset()))\n"
        f"import_nibabel_for(Path({str(ball)!r})); print(sys.modules['pydicom'] is pydicom)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.splitlines() == ["False", "True False", "None", "True"], ended.stderr


def test_a_command_makes_no_options_of_others():
    code = (
        "import importlib\n"
        "for command in ('refine', 'look', 'segment'):\n"
        "    importlib.import_module('accelsurf.cli.' + command)\n"
        "    print(*[made.__name__ for made in object.__subclasses__() if made.__module__ == 'accelsurf.cli.options'])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    made = [set(line.split()) for line in ended.stdout.splitlines()]
    both = {"Display", "ReadWithoutLevel"}
    assert made == [{"Display"}, both, both | {"Settings"}], ended.stderr


@pytest.mark.sampled(1)
@pytest.mark.parametrize("given", [("--start", "ball:0,0,0,4"), ("--inside", "point:0,0,0")])
def test_a_run_loads_the_kernels_that_it_calls_and_no_library_of_others(given, ball):
    words = ("segment", ball, "-o", ball.parent / "out", "--max-steps", "5", *given)
    assert execute(list(map(str, words))) == 0  # compiles what nobody has compiled before
    code, modules, kernels = loaded(*words, "--overwrite")
    assert code == 0
    # The preview is drawn by matplotlib, without its state machine.
    assert not packages_of(modules) & (OF_OTHERS - {"matplotlib"} | OF_DICOM)
    assert "matplotlib.pyplot" not in modules
    assert 20 < len(kernels) <= MOST_KERNELS[given[0].strip("-")], sorted(kernels)


def test_only_whole_settings_get_a_validator():
    code = (
        "from accelsurf.settings.run_config import RunConfig\n"
        "from accelsurf.settings.track_config import TrackConfig\n"
        "RunConfig(cfl=0.5), TrackConfig(model='none')\n"
        "made = [one.__pydantic_complete__ for kind in (RunConfig, TrackConfig) for one in kind.__mro__[:-2]]\n"
        "print(*made)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.split() == ["True", "False"] * 2, ended.stderr


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("3", "3")])
def test_the_program_starts_no_threads_for_linear_algebra(given, expected):
    code = (
        "import atexit, os; atexit.register(lambda: print(os.environ['OPENBLAS_NUM_THREADS'], flush=True)); "
        "from accelsurf.cli import main; main(['--version'])"
    )
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment
    )
    assert ended.stdout.splitlines()[-1] == expected


@pytest.mark.parametrize(
    ("started", "expected"), [("accelsurf.__main__", False), ("accelsurf.cli", True)]
)
def test_the_program_alone_looks_for_cycles_less_often(started, expected):
    code = (
        "import atexit, gc; before = gc.get_threshold(); "
        "atexit.register(lambda: print(before == gc.get_threshold(), gc.isenabled(), flush=True)); "
        f"import sys; sys.argv[1:] = ['--version']; from {started} import main; main()"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.splitlines()[-1] == f"{expected} True"


def test_no_time_of_a_run_goes_into_looking_for_cycles(ball):
    words = [
        "segment",
        str(ball),
        "-o",
        str(ball.parent / "out"),
        "--max-steps",
        "5",
        "--start",
        "ball:0,0,0,4",
    ]
    assert execute(words) == 0  # compiles what nobody has compiled before
    code = (
        "import atexit, gc, sys; from accelsurf.__main__ import main; before = gc.get_stats()[0]['collections']; "
        "atexit.register(lambda: print(gc.get_stats()[0]['collections'] - before, flush=True)); "
        f"sys.argv[1:] = {[*words, '--overwrite', '--quiet']!r}; main()"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.splitlines()[-1] == "0", ended.stderr


def test_the_viewer_loads_nothing_of_scipy_that_its_first_picture_does_not_need():
    code = (
        "import sys, accelsurf.viewer.actions.opening\n"
        "print([name for name in ('scipy.spatial', 'scipy.linalg', 'scipy.sparse', 'scipy.optimize') "
        "if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout.strip() == "[]", ended.stderr


@pytest.mark.parametrize(
    ("command", "threshold"), [("segment", 500_000), ("batch", 50_000), ("serve", 50_000)]
)
def test_what_goes_on_for_long_looks_for_cycles_sooner(command, threshold):
    """An image in a cycle would stay for the next cases."""
    code = (
        f"import atexit, gc, sys; sys.argv[1:] = ['{command}', '--help']; from accelsurf.__main__ import main; "
        "atexit.register(lambda: print('threshold', gc.get_threshold()[0], flush=True)); main()"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    ).stdout
    assert f"threshold {threshold}" in said
