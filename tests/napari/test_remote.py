"""napari's plug-in for nnInteractive, in Remote mode against `accelsurf serve`: driven by the mouse in a window."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import accelsurf
from tests.serve.conftest import KEY, started
from tests.support.screen import own_screen

NAMES = ("napari", "napari_nninteractive", "starlette", "uvicorn", "blosc2")
MISSING = [name for name in NAMES if importlib.util.find_spec(name) is None]
MISSING += [name for name in ("Xvfb",) if shutil.which(name) is None]
ROOT = Path(__file__).parents[2]
pytestmark = [
    pytest.mark.program,
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}"),
]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Labels after each prompt."""
    folder = tmp_path_factory.mktemp("remote")
    (folder / "server").mkdir()
    server = started(folder / "server", "--api-key", KEY)
    try:
        with own_screen(1400, 900) as display:
            env = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
            words = [
                sys.executable,
                "-m",
                "tests.support.remote_napari",
                server.address,
                KEY,
                folder / "labels.npz",
            ]
            done = subprocess.run(
                words, env=env, cwd=ROOT, capture_output=True, text=True, timeout=500
            )
        assert done.returncode == 0, done.stdout + done.stderr
    finally:
        server.process.kill()
        server.process.communicate()
    with np.load(folder / "labels.npz") as labels:
        return dict(labels)


def dice(found, truth):
    return (
        2
        * np.count_nonzero((found > 0) & truth)
        / (np.count_nonzero(found) + np.count_nonzero(truth))
    )


def truth_and_middle():
    from tests.support.remote_napari import phantom

    image, scale, middle = phantom()
    places = np.indices(image.shape)
    apart = [
        sum(((a - m) * h) ** 2 for a, m, h in zip(places, at, scale, strict=True))
        for at in (middle, (8, 24, 43))
    ]
    return apart[0] < 12.0**2, image, scale, middle


def test_a_point_is_that_of_the_library_with_the_layers_scale(found):
    truth, image, scale, middle = truth_and_middle()

    def by_library(spacing):
        places = np.indices(image.shape)
        ball = (
            sum(((a - m) * h) ** 2 for a, m, h in zip(places, middle, spacing, strict=True))
            <= 4.0**2
        )
        found = accelsurf.Interaction(image, spacing=spacing)
        found.add(accelsurf.Click("inside", tuple(slice(0, n) for n in image.shape), ball))
        return found.labels

    assert truth[middle] and np.array_equal(found["point"], by_library(scale))
    assert not np.array_equal(found["point"], by_library((1.0, 1.0, 1.0)))


@pytest.mark.parametrize("tool", ["point", "scribble", "labels"])
def test_a_point_outside_takes_the_other_ball_away(found, tool):
    truth, *_ = truth_and_middle()
    assert dice(found[f"{tool}, corrected"], truth) > 0.95 > 0.8 > dice(found[tool], truth)


def test_outlines_bound_the_object_in_their_slice_and_a_point_inside_adds(found):
    truth, _, _, (z, y, x) = truth_and_middle()
    assert dice(found["lasso"], truth) > 0.95
    for tool in ("box", "lasso"):
        assert found[tool][z, y, x] == 1 and not found[tool][z, :, 36:].any()
        assert dice(found[tool][z], truth[z]) > 0.95
        assert found[f"{tool}, corrected"][z, y, x + 23] == 1


@pytest.mark.parametrize("tool", ["point", "box", "scribble", "lasso"])
def test_undo_goes_back_to_the_beginning(found, tool):
    assert not np.array_equal(found[f"{tool}, corrected"], found[tool])
    assert np.array_equal(found[f"{tool}, undone"], found[tool])
    assert found[tool].any() and not found[f"{tool}, undone twice"].any()
