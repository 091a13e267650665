"""accelsurf track: files, refusals, Ctrl-C and --resume."""

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.grid.geometry import Geometry
from accelsurf.track.track import Tracking

GRID = Geometry((1, 32, 56), (1.0, 0.5, 0.5))


@pytest.fixture
def cells(tmp_path: Path) -> Path:
    """Two discs that travel: 4D, one slice."""
    y, x = np.indices(GRID.shape[1:]).astype(float)
    path = tmp_path / "cells.nii.gz"
    with io.SequenceWriter(path, GRID, (0.0, 2.0, 4.0, 6.0, 8.0), "s", np.float32) as writer:
        for n in range(5):
            noise = np.random.default_rng(n).normal(0, 4, x.shape)
            discs = [np.clip(6.5 - np.hypot(x - a, y - 16), 0, 1) for a in (10 + 2 * n, 46 - 2 * n)]
            writer.write(n, (100 * sum(discs) + noise)[None].astype(np.float32))
    return path


def files_of(folder: Path) -> dict[str, bytes]:
    """What is in the files, without what differs from run to run: seconds and dates."""
    return {
        path.name: path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(("report.json", "run.toml"))
    }


def tracked(cells: Path, out: Path, *options: str) -> int:
    return execute(
        [
            "track",
            str(cells),
            "-o",
            str(out),
            "--start",
            "otsu",
            "--threads",
            "1",
            "--quiet",
            *options,
        ]
    )


def test_a_tracking_leaves_labels_tracks_and_a_report(cells: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert tracked(cells, out) == 0
    rows = list(csv.DictReader((out / "cells_tracks.csv").read_text().splitlines()))
    assert [row["id"] for row in rows] == ["1", "2"] * 5
    assert [float(row["x_mm"]) for row in rows if row["id"] == rows[0]["id"]] == pytest.approx(
        [5 + n for n in range(5)] if float(rows[0]["x_mm"]) < 14 else [23 - n for n in range(5)],
        abs=0.15,
    )
    assert abs(float(rows[-1]["vx"])) == pytest.approx(0.5, abs=0.05)  # mm per second
    labels = io.read_sequence(out / "cells_labels.nii.gz")
    assert len(labels) == 5 and set(np.unique(labels.frame(4).array)) == {0, 1, 2}
    report = json.loads((out / "cells_report.json").read_text())
    assert report["status"] == "ok" and report["exit_code"] == 0
    assert not (out / "cells_checkpoint.npz").exists() and not (out / "cells_frames").exists()
    again = tmp_path / "again"
    assert (
        execute(
            [
                "track",
                str(cells),
                "-o",
                str(again),
                "--config",
                str(out / "cells_run.toml"),
                "--quiet",
            ]
        )
        == 0
    )
    assert files_of(again) == files_of(out)
    assert tracked(cells, out) == 7  # there are files


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(
    cells: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert tracked(cells, whole) == 0
    step = Tracking.step

    def killed(self: Tracking):  # type: ignore[no-untyped-def]
        if self.done == 3:
            raise KeyboardInterrupt
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(Tracking, "step", killed)
        assert tracked(cells, out) == 130
    assert (out / "cells_checkpoint.npz").exists() and not (out / "cells_tracks.csv").exists()
    assert tracked(cells, out) == 7  # the state would be lost
    assert tracked(cells, out, "--resume", "--model", "none") == 3
    with monkeypatch.context() as patch:
        done: list[int] = []
        patch.setattr(Tracking, "step", lambda self: (done.append(self.done), step(self))[1])
        assert tracked(cells, out, "--resume") == 0
    assert done == [3, 4]
    assert files_of(out) == files_of(whole)


@pytest.mark.parametrize(("number", "event"), [(signal.SIGTERM, "frame"), (signal.SIGINT, "step")])
def test_a_signal_leaves_no_tracks_but_a_state(
    cells: Path, tmp_path: Path, number: int, event: str
) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert tracked(cells, whole) == 0
    words = (
        "track",
        str(cells),
        "-o",
        str(out),
        "--start",
        "otsu",
        "--threads",
        "1",
        "--progress",
        "json",
    )
    program = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words], stderr=subprocess.PIPE, text=True
    )
    assert program.stderr is not None
    for line in program.stderr:
        if line.startswith("{") and json.loads(line)["event"] == event:
            program.send_signal(number)
            break
    _, error = program.communicate(timeout=60)
    assert program.returncode == 128 + number, error
    # In the first frame nothing is done yet.
    kept = {"cells_checkpoint.npz", "cells_frames"} if event == "frame" else set()
    assert {path.name for path in out.iterdir()} == kept
    assert ("to go on: accelsurf track" in error) == bool(kept)
    assert tracked(cells, out, "--resume") == 0
    assert files_of(out) == files_of(whole)


def test_what_cannot_be_tracked_is_refused_in_a_line(cells: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    for options, code, line in (
        (("--frame", "9"), 2, "frame: frame 9 was given, expected 0 to 4"),
        (("--model", "magic"), 2, "model: magic was given"),
        (("--observer", "2,1"), 2, "observer: 2,1 was given"),
        (("--correct", "frame=1"), 2, "correct:"),
        (
            ("--correct", "frame=0 inside=point:5,8,0", "--frame", "2", "--direction", "forward"),
            2,
            "correct: frame 0 was given",
        ),
        (("--max-gap", "-1"), 2, "max_gap: -1 was given"),
    ):
        assert tracked(cells, out, *options) == code
        assert line in capsys.readouterr().err
    assert not any(out.glob("cells_[!r]*")) if out.exists() else True
    single = tmp_path / "single.nii.gz"
    io.write(io.read_sequence(cells).frame(0), single)
    assert tracked(single, out) == 3
    assert (
        execute(
            [
                "track",
                str(cells),
                "-o",
                str(out),
                "--energy",
                "threshold:500,",
                "--start",
                "ball:5,8,0,2",
            ]
        )
        == 5
    )


def test_the_last_lines_name_the_table_and_the_picture_to_look_at(
    cells: Path, tmp_path: Path, capsys
) -> None:
    assert execute(["track", str(cells), "-o", str(tmp_path), "--start", "otsu"]) == 0
    *_, table, picture = capsys.readouterr().out.splitlines()
    for line, word, end in ((table, "tracks", "tracks.csv"), (picture, "preview", "preview.png")):
        assert line.split() == [word, str(tmp_path / f"cells_{end}")]
        assert (tmp_path / f"cells_{end}").is_file()


def test_dump_config_has_a_table_of_tracking(cells: Path, capsys) -> None:
    assert execute(["track", "--dump-config", "--observer", "1,0.5", "--smoothness", "0.2"]) == 0
    text = capsys.readouterr().out
    assert "smoothness = 0.2" in text and "[track]\n" in text and 'observer = "1,0.5"' in text


def test_a_failure_has_a_report_and_does_not_stand_in_the_way(
    cells: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "out"
    for options, message in ((("--frame", "9"), "frame 9"), (("--energy", "threshold:500,"), "")):
        assert tracked(cells, out, *options) in (2, 5)
        report = json.loads((out / "cells_report.json").read_text())
        assert report["status"] == "failed" and message in report["error"]["message"]
        assert [path.name for path in out.iterdir()] == ["cells_report.json"]
    assert tracked(cells, out) == 0  # without --overwrite: there was no result
    before = files_of(out)
    assert tracked(cells, out, "--frame", "9") == 2
    assert (
        json.loads((out / "cells_report.json").read_text())["status"] == "ok"
        and files_of(out) == before
    )
    assert json.loads((out / "cells_failed_report.json").read_text())["status"] == "failed"
    (tmp_path / "torn.nii.gz").write_bytes(cells.read_bytes()[:100])
    assert tracked(tmp_path / "torn.nii.gz", out) == 3
    assert json.loads((out / "torn_report.json").read_text())["input"]["path"] == str(
        tmp_path / "torn.nii.gz"
    )
