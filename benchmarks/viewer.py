"""How much a window slows the solver, and how soon it answers a key, with a large volume evolving.

Usage: python -m benchmarks.viewer [--size 256] [--steps 40] [--display :N] [-o benchmarks/results/viewer.json]

Runs the same steps three times: by a Run alone, by a Session that nobody watches (it stores checkpoints),
and in the window, on the display given or a screen of its own (Xvfb, xdotool). Keys are sent by xdotool; the answer is
timed inside the window, when what the key asked for has been done and drawn. Software rendering competes with the
solver for the same cores: on a machine with a graphics card the window costs less. Run it on a quiet machine.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.support.screen import own_screen

ROOT = Path(__file__).resolve().parent.parent
KEYS = 12


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--size", type=int, default=256)
    options.add_argument("--steps", type=int, default=40)
    options.add_argument("--display", default="")
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/viewer.json"
    )
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        source, start = phantom(given.size, Path(folder))
        plain = [seconds_alone(source, start, given.steps) for _ in range(2)]
        session = seconds_of_session(source, start, given.steps)
        if not shutil.which("xdotool") or not (given.display or shutil.which("Xvfb")):
            sys.exit("Xvfb and xdotool are needed, or --display of a screen and xdotool")
        with contextlib.nullcontext(given.display) if given.display else own_screen() as display:
            window = in_window(source, start, given.steps, display, Path(folder))
    alone = min(wall for wall, _ in plain)
    answered = window["answered_ms"]
    report = {
        "size": given.size,
        "steps": given.steps,
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "machine": platform.machine(),
        "seconds": {"alone": alone, "session": session[0], "window": window["seconds"]},
        "cpu_seconds": {
            "alone": min(cpu for _, cpu in plain),
            "session": session[1],
            "window": window["cpu_seconds"],
        },
        "slowdown": {
            "session": session[0] / alone - 1.0,
            "window": window["seconds"] / alone - 1.0,
        },
        "key_answered_ms": {
            "median": float(np.median(answered)),
            "largest": max(answered),
            "all": answered,
        },
        "frames": window["frames"],
        "drawing_ms": window["drawing_ms"],
    }
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(report, indent=2))


def phantom(n: int, folder: Path) -> tuple[Path, str]:
    """A large ball in noise, and a start inside it that grows for as long as is measured."""
    from accelsurf import io
    from accelsurf.image.volume import Volume

    shapes = ((-1, 1, 1), (1, -1, 1), (1, 1, -1))
    z, y, x = (np.arange(n, dtype=np.float32).reshape(shape) - 0.5 * n for shape in shapes)
    image = np.random.default_rng(0).normal(0, 25, (n, n, n)).astype(np.float32)
    image += 100.0 * (z**2 + y**2 + x**2 < (0.4 * n) ** 2)
    path = folder / "scan.nii"
    io.write(Volume.from_array(image), path)
    half = f"{0.5 * n:g}"
    return path, f"ball:{half},{half},{half},{0.27 * n:g}"


def config_of(start: str):
    from accelsurf.settings.run_config import RunConfig

    return RunConfig(start=start, levels=1, max_steps=100_000)


def seconds_alone(source: Path, start: str, steps: int) -> tuple[float, float]:
    """Wall and processor time."""
    from accelsurf import io
    from accelsurf.run.run import Run

    with Run(io.read(source), config_of(start)) as run:
        run.step()
        began, spent = time.perf_counter(), time.process_time()
        for _ in range(steps):
            run.step()
        return time.perf_counter() - began, time.process_time() - spent


def seconds_of_session(source: Path, start: str, steps: int) -> tuple[float, float]:
    """Wall and processor time."""
    from accelsurf import io
    from accelsurf.viewer.core.session import Session

    with Session(io.read(source), config_of(start)) as session:
        session.ready.result()
        session.single_step().result()
        session.wait()
        began, spent = time.perf_counter(), time.process_time()
        session.play(1 + steps).result()
        session.wait()
        return time.perf_counter() - began, time.process_time() - spent


def in_window(source: Path, start: str, steps: int, display: str, folder: Path) -> dict:
    result_file = folder / "result.json"
    env = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
    words = [
        sys.executable,
        "-m",
        "benchmarks.viewer",
        "--in-window",
        str(source),
        str(result_file),
        start,
        str(steps),
    ]
    child = subprocess.Popen(words, env=env, cwd=ROOT)
    try:
        sent = []
        while not result_file.with_suffix(".running").exists() and child.poll() is None:
            time.sleep(0.1)
        focus = ["xdotool", "search", "--onlyvisible", "--name", "accelsurf - ", "windowfocus"]
        subprocess.run(focus, env=env, check=True)
        while not result_file.exists() and child.poll() is None:
            time.sleep(0.3)
        # The time is over; it goes on, and keys come while it does.
        for _ in range(KEYS):
            time.sleep(0.75 + 0.1 * (len(sent) % 7))
            sent.append(time.time())
            subprocess.run(["xdotool", "key", "F1"], env=env, check=True)
        time.sleep(1.0)
        subprocess.run(["xdotool", "key", "ctrl+q"], env=env, check=True)
        child.wait(60)
    finally:
        child.kill()
    found = json.loads(result_file.read_text())
    seen = json.loads(result_file.with_suffix(".keys").read_text())
    if len(seen) != len(sent):
        sys.exit(f"{len(sent)} keys were sent, {len(seen)} were answered")
    found["answered_ms"] = [round(1000.0 * (b - a), 1) for a, b in zip(sent, seen, strict=True)]
    return found


def window_process(source: str, result_file: str, start: str, steps: int) -> None:
    """What happens in the other process."""
    from PySide6.QtCore import QTimer

    from accelsurf import io
    from accelsurf.viewer.core.session import Session
    from accelsurf.viewer.window.desktop import Window, application

    app = application()
    path = Path(result_file)
    session = Session(io.read(source), config_of(start), name="scan")
    session.ready.result()
    answers = []
    drawn = []
    times = {}

    class Timed(Window):
        def toggle_help(self) -> None:
            super().toggle_help()
            self.help.repaint()
            answers.append(time.time())

    window = Timed(session)
    window.show()

    def watch() -> None:
        status = session.status
        if window.scene.frame is not None and "first" not in times:
            times["first"] = time.perf_counter()
            session.single_step()
        elif "first" in times and "began" not in times and status.step == 1 and not status.playing:
            if window.scene.frame.step == 1:
                path.with_suffix(".running").write_text("")
                times["began"], times["cpu"] = time.perf_counter(), time.process_time()
                session.play()
        elif "began" in times and "ended" not in times and status.step >= 1 + steps:
            times["ended"] = time.perf_counter()
            path.write_text(
                json.dumps(
                    {
                        "seconds": times["ended"] - times["began"],
                        "cpu_seconds": time.process_time() - times["cpu"],
                        "frames": len(drawn),
                        "drawing_ms": round(1000 * float(np.median(drawn)), 1) if drawn else None,
                    }
                )
            )
        if times.get("began") and window.scene.frame.step != times.get("frame"):
            times["frame"] = window.scene.frame.step
            drawn.append(window.drawing_seconds)

    timer = QTimer(window, interval=1)
    timer.timeout.connect(watch)
    timer.start()
    app.exec()
    path.with_suffix(".keys").write_text(json.dumps(answers))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--in-window"]:
        window_process(*sys.argv[2:5], int(sys.argv[5]))
    else:
        main()
