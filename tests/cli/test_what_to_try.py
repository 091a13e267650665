"""The command that is named to try next, and a rest in the report."""

import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume
from accelsurf.settings.wording import volume_text
from tests.evolution.test_plateaus import LEAK, joined_balls
from tests.support.part_and_whole import part_and_whole

SHAPE = (24, 40, 40)


def two_shells(path, step=1.0):
    """A bright ball in a dimmer one, in noise: an object of either size."""
    index = np.indices(SHAPE) - np.array([12, 20, 20])[:, None, None, None]
    distance = np.sqrt((index**2).sum(axis=0))
    image = 100.0 * (distance < 4) + 60.0 * ((distance >= 4) & (distance < 10))
    image += np.random.default_rng(0).normal(0, 8, SHAPE)
    io.write(Volume.from_array(image.astype(np.float32), (step, step, step)), path)
    return path


def run(path, *words):
    options = ("-o", path.parent / "out", "--progress", "none", "--threads", "1", "--overwrite")
    return cli.execute([str(word) for word in ("segment", path, *options, *words)])


def report(path):
    return json.loads((path.parent / "out" / f"{path.name.split('.')[0]}_report.json").read_text())


@pytest.mark.sampled(1)
@pytest.mark.parametrize("step", [1.0, 2e-4])
def test_other_answers_are_named_with_the_option_that_takes_one(step, tmp_path, capsys):
    path, click = tmp_path / "scan.nii.gz", "ball:14,16,12,4vox"
    image = part_and_whole()[0]
    io.write(Volume.from_array(image.array, tuple(h * step for h in image.geometry.spacing)), path)
    assert run(path, "--inside", click) == 0
    said = capsys.readouterr().out
    (line,) = (line for line in said.splitlines() if "the first click may also mean" in line)
    first, other, alike = (answer["volume_mm3"] for answer in report(path)["quality"]["answers"])
    rest = "all that is alike and connected (--answer 3)"
    assert (
        line.endswith(f"may also mean {volume_text(other)} (--answer 2) or {rest}")
        and alike is None
    )
    assert first > 1.3 * other  # the drawn ratio is 1.38
    # A place in micrometres has the digits to be typed again.
    place = said.split("most doubtful near ")[1].split()[0]
    assert run(path, "--inside", click, "--outside", f"point:{place}") in (0, 5)
    capsys.readouterr()
    assert run(path, "--inside", click, "--answer", "2") == 0
    assert (
        "the first click may also mean" in (said := capsys.readouterr().out)
        and "--answer 1" in said
    )
    # Before it is taken, its size is that of the model; afterwards, that of the surface.
    assert report(path)["volume_mm3"] == pytest.approx(other, rel=0.05)
    taken = report(path)["quality"]["answers"][0]["volume_mm3"]
    assert taken == pytest.approx(report(path)["volume_mm3"], rel=0.01)
    size = f"{other:.0f}mm3" if step == 1.0 else f"{1e9 * other:.0f}um3"
    assert run(path, "--inside", click, "--size", size) == 0
    assert "may also mean" not in capsys.readouterr().out
    assert (
        report(path)["volume_mm3"] == pytest.approx(other, rel=0.3)
        and len(report(path)["quality"]["answers"]) == 1
    )


@pytest.mark.parametrize(
    ("words", "reason", "hint"),
    [
        (
            ("--start", "ball:20,20,12,3vox", "--energy", "threshold:226,"),
            "vanished",
            "try --energy threshold:learned,learned",
        ),
        (
            ("--start", "ball:20,20,12,3vox", "--energy", "threshold:-99,", "--smoothness", "0"),
            "filled",
            "try --inside ball:",
        ),
        (
            ("--start", "ball:20,20,12,3vox", "--energy", "threshold:-99,", "--smoothness", "500"),
            "vanished",
            "try --smoothness ",
        ),
    ],
)
def test_an_empty_result_names_what_was_seen_before_the_first_step(
    words, reason, hint, tmp_path, capsys
):
    path = two_shells(tmp_path / "scan.nii.gz")
    assert run(path, *words) == 5
    (last,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("hint: "))
    assert last.startswith(f"hint: {hint}") and "start closer" not in last and last.count("--") <= 3
    assert report(path)["stop"]["reason"] == reason and report(path)["error"][
        "hint"
    ] == last.removeprefix("hint: ")


@pytest.mark.slow
def test_a_plateau_is_reported_and_a_run_that_ends_there_has_its_volume(tmp_path):
    path, words = tmp_path / "balls.nii.gz", []
    io.write(Volume.from_array(joined_balls()[0].astype(np.float32)), path)
    for key in ("start", "energy", "smoothness"):
        words += [f"--{key}", LEAK[key]]
    words += ["--levels", "1"]
    assert run(path, *words) == 0
    leaked = report(path)
    (rest,) = leaked["quality"]["rests"]
    assert "rest1" not in [one["kind"] for one in leaked["outputs"]]
    assert run(path, *words, "--stop-at-rest") == 0
    at_plateau = report(path)
    assert at_plateau["stop"]["reason"] == "rested" and at_plateau["quality"]["rests"] == [rest]
    assert at_plateau["volume_mm3"] == pytest.approx(rest["volume_mm3"], rel=0.02)
    assert leaked["volume_mm3"] > 1.8 * at_plateau["volume_mm3"]
