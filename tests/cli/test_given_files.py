"""Pipes, devices, sockets and folders in the place of files: each option refuses them at once, in one line.

The options are those that the settings and the commands have: a new one that takes a file is asked too.
"""

import importlib
import inspect
import os
import re
import signal
import socket

import numpy as np
import pytest

from accelsurf import io
from accelsurf.batch import pool
from accelsurf.cli import execute
from accelsurf.image.volume import Volume
from accelsurf.phantoms import recipe_files
from accelsurf.settings.catalogue import entry
from accelsurf.settings.entry import full_help
from accelsurf.settings.run_config import RunConfig
from tests.support.batch_jobs import InlinePool

#: What stands for its own name in commands of which the settings say nothing.
COMMANDS = {
    "look": ["look", "{image}", "-o", "{out}"],
    "segment": ["segment", "{image}", "-o", "{out}", "--start", "center"],
    "track": ["track", "{image}", "-o", "{out}", "--start", "center"],
    "movie": ["movie", "{image}", "-o", "{out}.gif", "--start", "center"],
    "evaluate": ["evaluate", "{image}", "{image}"],
    "batch": ["batch", "{image}", "-o", "{out}", "--start", "center"],
    "refine": ["refine", "{out}", "--inside", "point:1,1,1"],
}
OUTPUTS = {"output", "table"}


def options():
    """(command, words) with PIPE in the place of each file that may be given."""
    for key, field in RunConfig.model_fields.items():
        option, said = "--" + key.replace("_", "-"), entry(key)
        named = re.findall(r"([a-z]+:)FILE", full_help(field) + (said.metavar or ""))
        for word in dict.fromkeys([*named, *([""] if said.metavar == "FILE" else [])]):
            for suffix in (".nii", ".csv", ".stl"):
                yield "segment", (option, f"{word}PIPE{suffix}")
    for command in COMMANDS:
        function = getattr(importlib.import_module(f"accelsurf.cli.{command}"), command)
        for name, parameter in inspect.signature(function).parameters.items():
            takes_file = (
                re.search("Path|File", str(parameter.annotation))
                and parameter.kind is parameter.KEYWORD_ONLY
            )
            if takes_file and name not in OUTPUTS:
                names = re.findall(r"'(--[a-z-]+)'", str(parameter.annotation))
                suffix = {"config": ".toml", "pairs": ".csv", "names": ".csv"}.get(name, ".nii")
                yield (
                    command,
                    (names[0] if names else "--" + name.replace("_", "-"), f"PIPE{suffix}"),
                )


ALL = list(dict.fromkeys(options()))
FIRST = [(command, suffix) for command in COMMANDS for suffix in (".nii", ".zip", ".csv", ".toml")]


def test_options_are_found():
    said = {words[0] for _, words in ALL} | {words[1].partition("PIPE")[0] for _, words in ALL}
    assert {
        "--config",
        "--objects",
        "--labels",
        "--mask",
        "--channel",
        "--label-table",
        "--reference",
    } <= said
    assert {"--pairs", "--image", "--start", "--inside", "label:", "mesh:", "stroke:"} <= said


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    path = tmp_path_factory.mktemp("image") / "image.nii"
    io.write(
        Volume.from_array(np.random.default_rng(0).normal(size=(6, 7, 8)).astype(np.float32), 1.0),
        path,
    )
    return path


@pytest.fixture(autouse=True)
def no_workers(monkeypatch):
    """Cases of a batch are refused in this process."""
    monkeypatch.setattr(pool, "LocalPool", InlinePool)


@pytest.fixture(autouse=True)
def no_hang():
    def too_long(*_):
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.setitimer(signal.ITIMER_REAL, 20.0)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def made(kind, path):
    """What is no file, at a path."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as one:
            here = os.getcwd()
            os.chdir(path.parent)  # the path of a socket may not be long
            try:
                one.bind(path.name)
            finally:
                os.chdir(here)


def refused(words, capfd, what):
    code = execute(words)
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    if code == 9:  # a case of a batch failed
        assert words[0] == "batch" and "failed: " in err and "pipe" in err
        return
    assert code in (2, 3, 7), (code, err)
    assert [line.partition(":")[0] for line in lines] == ["error", "hint"], err
    if what != "folder" and "refine" not in words:
        assert "pipe" in lines[0] or "no such" in lines[0] or "not" in lines[0], err


@pytest.mark.sampled(16)
@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize(
    ("command", "words"), ALL, ids=lambda value: value if value in COMMANDS else " ".join(value)
)
def test_options_refuse_what_is_no_file(command, words, kind, image, tmp_path, capfd):
    suffix = words[1].partition("PIPE")[2]
    path = tmp_path / f"given{suffix}"
    made(kind, path)
    given = [word.format(image=image, out=tmp_path / "out") for word in COMMANDS[command]]
    if words[0] == "--start":
        given = given[: given.index("--start")]
    if words[0] == "--pairs":
        given = [command]
    refused([*given, words[0], words[1].replace(f"PIPE{suffix}", str(path))], capfd, kind)
    left = (
        {path.name for path in (tmp_path / "out").iterdir()}
        if (tmp_path / "out").exists()
        else set()
    )
    assert all(name.endswith("_report.json") for name in left), left


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
@pytest.mark.parametrize(("command", "suffix"), FIRST)
def test_commands_refuse_it_in_the_place_of_their_input(
    command, suffix, kind, image, tmp_path, capfd
):
    path = tmp_path / f"given{suffix}"
    made(kind, path)
    words = [word.replace("{image}", str(path)) for word in COMMANDS[command]]
    words = [str(path) if command == "refine" and word == "{out}" else word for word in words]
    refused([word.format(out=tmp_path / "out") for word in words], capfd, kind)


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
def test_a_pipe_as_report_or_state_or_recipe(kind, image, tmp_path, capfd):
    (tmp_path / "out").mkdir()
    made(kind, tmp_path / "out" / "image_report.json")
    refused(["refine", str(tmp_path / "out"), "--inside", "point:1,1,1"], capfd, kind)
    made(kind, tmp_path / "recipe.toml")
    with pytest.raises(recipe_files.InputError, match="pipe"):
        recipe_files.read_recipe(tmp_path / "recipe.toml")
    (tmp_path / "out2").mkdir()
    made(kind, tmp_path / "out2" / "image_checkpoint.npz")
    words = [
        "segment",
        str(image),
        "-o",
        str(tmp_path / "out2"),
        "--start",
        "ball:3,3,3,2",
        "--resume",
    ]
    refused([*words, "--checkpoint", "1"], capfd, kind)
