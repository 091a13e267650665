"""Commands of the studies: what the simulated person clicks, typed."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from benchmarks import typed
from benchmarks.clicks.person import PersonClick


def test_a_click_is_rounded_to_a_tenth_of_the_finest_spacing() -> None:
    click = PersonClick("inside", (1, 2, 3), (0.38281, 0.25520, 0.28371), 0.51249)
    assert (
        typed.text_of(click, Geometry((9, 9, 9), (0.2837, 0.1276, 0.1276)))
        == "ball:0.38,0.26,0.28,0.51"
    )
    assert typed.text_of(click, Geometry((9, 9, 9), (2.0, 2.0, 2.0))) == "point:0.4,0.3,0.3"


def test_a_game_is_played_by_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, for speed. The second click answers what the first run has wrong."""
    z, y, x = np.indices((24, 24, 24)) - 11.5
    truth = np.asarray(x**2 + y**2 + z**2 < 64) | (np.asarray(x > 0) & (y**2 + z**2 < 4))
    grid = Geometry(truth.shape, (1.0, 1.0, 1.0))
    image = 100.0 * truth + np.random.default_rng(0).normal(0, 60, truth.shape)
    source = tmp_path / "scan.nii.gz"
    io.write(Volume(image.astype(np.float32), grid), source)
    ran: list[list[str]] = []

    def call(words: list[str], folder: Path) -> dict[str, object]:
        ran.append(words)
        code = cli.execute(words)
        return {"exit_code": code, "seconds": 0.0} | ({"error": "failed"} if code else {})

    monkeypatch.setattr(typed, "call", call)
    rows = typed.play(
        source, tmp_path / "out", Volume(truth.astype(np.uint8), grid), clicks=2, threads=1
    )
    assert [row["exit_code"] for row in rows] == [0, 0]
    first, second = (shlex.split(row["command"]) for row in rows)
    assert first[:6] == ["accelsurf", "segment", "scan.nii.gz", "-o", "out", "--inside"]
    assert first[6].startswith("ball:") and first[6] in ran[0]
    assert second[:3] == ["accelsurf", "refine", "out"] and second[3] in ("--inside", "--outside")
    assert second[4] in ran[1] and min(row["metrics"]["dice"] for row in rows) > 0.8
    assert rows[0]["stop"]["reason"] and rows[0]["quality"]["probability"] is not None


def test_a_command_that_fails_ends_the_game(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        typed, "call", lambda words, folder: {"exit_code": 3, "seconds": 0.0, "error": "no"}
    )
    truth = Volume(np.ones((4, 4, 4), np.uint8), Geometry((4, 4, 4), (1.0, 1.0, 1.0)))
    rows = typed.play(tmp_path / "scan.nii.gz", tmp_path / "out", truth)
    assert len(rows) == 1 and rows[0]["error"] == "no" and "metrics" not in rows[0]
