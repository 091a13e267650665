"""From a tracking to the viewer: ``view --frame-time`` and ``--frames-from-slices``."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from accelsurf import cli, io
from accelsurf.cli import view
from accelsurf.image.volume import Volume
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing

FRAMES = 3


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    """A disc that travels, as the slices of a TIFF that does not name its axis."""
    y, x = np.indices((20, 32)).astype(float)
    discs = [np.clip(5.5 - np.hypot(x - 9 - 2 * n, y - 10), 0, 1) for n in range(FRAMES)]
    tifffile.imwrite(
        tmp_path / "disc.tif", (100 * np.stack(discs)).astype(np.float32), photometric="minisblack"
    )
    return tmp_path / "disc.tif"


@pytest.fixture
def seen(monkeypatch) -> list[dict]:
    """What a window would show, driven without one: the state at each frame."""
    viewing.needs_graphics()
    found: list[dict] = []

    def drive(opening, opened: tuple[OpenedImage, Session], *others) -> None:
        first, session = opened
        session.start_preparing()  # as the window does, with its first picture
        session.ready.result(60)
        scene = Scene(first.volume, size=(320, 180))
        actions = Actions(session, scene, frames=first.frames)
        begun = actions.state()["frame"]
        for number in range(actions.state()["frames"]):
            actions.request("frame", number)
            drawn = (
                [one.id for one in scene.frame.surfaces] if first.frames.tracks is not None else []
            )
            state = actions.state()
            found.append(
                {
                    "words": state["frame_words"],
                    "lines": state["frame_lines"],
                    "ids": drawn,
                    "begun": begun,
                }
            )
        scene.close()

    monkeypatch.setattr(
        view, "front_end", lambda page, begin=lambda: None: begin() or replace(page, browser=False)
    )
    monkeypatch.setattr(view, "open_window", drive)
    return found


def track(stack: Path, out: Path, *options: str) -> int:
    words = ["track", str(stack), "-o", str(out), "--start", "otsu", "--threads", "1", "--quiet"]
    return cli.execute([*words, "--frames-from-slices", "--frame-time", "0.5", *options])


def test_a_tracking_is_opened_on_its_sequence(stack: Path, tmp_path: Path, seen) -> None:
    out = tmp_path / "out"
    assert track(stack, out, "--also", "surfaces", "--frame", "1", "--direction", "both") == 0
    words = (
        "view",
        str(stack),
        "--tracks",
        str(out),
        "--frames-from-slices",
        "--frame-time",
        "0.5",
        "--no-recent",
    )
    assert cli.execute(list(words)) == 0
    assert [one["words"] for one in seen] == [
        f"frame {n} of 0 to 2, {0.5 * n:.4g} s" for n in range(FRAMES)
    ]
    assert [one["ids"] for one in seen] == [[1]] * FRAMES
    assert "predicted" in seen[0]["lines"]


def test_slices_are_frames_without_tracks_too(stack: Path, seen) -> None:
    assert cli.execute(["view", str(stack), "--frames-from-slices", "--no-recent"]) == 0
    assert [one["words"] for one in seen] == [f"frame {n} of 0 to 2" for n in range(FRAMES)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--frame-time", "2"), "frame_time: it was given without a sequence"),
        (("--frames-from-slices",), "frames_from_slices: it was given without a sequence"),
        (("IMAGE", "--frame-time", "2"), "frame_time: it was given for a single image"),
        (
            ("IMAGE", "--frame-time", "-1"),
            "frame_time: -1 was given, expected a number greater than 0",
        ),
    ],
)
def test_times_without_frames_are_refused(
    words, message, stack: Path, tmp_path: Path, seen, capsys
) -> None:
    io.write(Volume.from_array(np.zeros((4, 5, 6), np.float32)), tmp_path / "a.nii")
    given = [str(tmp_path / "a.nii") if word == "IMAGE" else word for word in words]
    assert cli.execute(["view", *given, "--no-recent"]) == 2
    assert message in capsys.readouterr().err and not seen
