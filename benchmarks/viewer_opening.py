"""How soon an image is on the screen: from the command, and from its choice in a window that is open already.

Usage: python -m benchmarks.viewer_opening [--shape 512,512,300] [--repeats 3] [--display :N]
[-o benchmarks/results/viewer_opening.json]

A CT in noise is written as .nii.gz and .nii (x,y,z voxels, int16; noise makes the first about half the size of the
second, as that of scanners). Each is opened in turn: by ``accelsurf view FILE`` in a new process, timed from its start;
and in a window whose start page is shown, timed from the request. Both end when the first picture with the slices has
been painted; what its thread has worked until then is beside it, since a busy machine changes that less. Run it on a
quiet machine, once before to fill the caches.
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
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.support.screen import own_screen

ROOT = Path(__file__).resolve().parent.parent
WAYS = ("command", "window")


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--shape", default="512,512,300")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--display", default="")
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/viewer_opening.json"
    )
    given = options.parse_args()
    nx, ny, nz = (int(n) for n in given.shape.split(","))
    if not (given.display or shutil.which("Xvfb")):
        sys.exit("Xvfb is needed, or --display of a screen")
    with tempfile.TemporaryDirectory() as folder:
        files = ct((nz, ny, nx), Path(folder))
        with contextlib.nullcontext(given.display) if given.display else own_screen() as display:
            found = measured(files, display, Path(folder), given.repeats)
        sizes = {path.suffix: path.stat().st_size for path in files}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    report = {
        "cores": cores,
        "machine": platform.machine(),
        "load": round(os.getloadavg()[0], 2),
        "bytes": sizes,
    }
    known = json.loads(given.output.read_text()) if given.output.exists() else {}
    known[given.shape] = report | found
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(known, indent=2) + "\n")
    print(json.dumps(known[given.shape], indent=2))


def ct(shape: Sequence[int], folder: Path) -> list[Path]:
    """A body with lungs, spine and liver in the noise of a scanner, packed and not."""
    from scipy.ndimage import gaussian_filter

    from accelsurf import io
    from accelsurf.grid.geometry import Geometry
    from accelsurf.image.volume import Volume

    nz, ny, nx = shape
    z, y, x = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape)
    y, x = np.meshgrid(y, x, indexing="ij")
    rng, image = np.random.default_rng(0), np.empty(tuple(shape), np.int16)
    for k in range(nz):
        wide = 0.8 * np.sqrt(1.0 - 0.3 * z[k] ** 2)
        body = (x / wide) ** 2 + (y / (0.75 * wide)) ** 2
        values = np.where(body < 1.0, np.where(body > 0.8, -100.0, 40.0), -1000.0)
        values[((x + 0.25) / 0.3) ** 2 + (y / 0.28) ** 2 + (z[k] / 0.5) ** 2 < 1.0] = 110.0
        for middle in (-0.33, 0.33):
            values[
                ((x - middle) / 0.24) ** 2 + (y / 0.3) ** 2 + ((z[k] + 0.7) / 0.5) ** 2 < 1.0
            ] = -850.0
        values[(x**2 + (y - 0.33) ** 2) < 0.01] = 400.0
        noise = gaussian_filter(rng.normal(0.0, 1.0, (ny, nx)).astype(np.float32), 0.7)
        values = gaussian_filter(values, 0.6) + noise * (18.0 / noise.std())
        values[x**2 + y**2 > 1.0] = -1024.0  # beyond what the scanner sees
        image[k] = np.clip(np.rint(values), -1024, 3071)
    volume = Volume(image, Geometry(tuple(shape), (1.0, 0.75, 0.75)))
    files = [folder / "ct.nii.gz", folder / "ct.nii"]
    for path in files:
        io.write(volume, path)
    return files


def measured(
    files: Sequence[Path], display: str, folder: Path, repeats: int
) -> dict[str, dict[str, list[float]]]:
    """Seconds of each way for each file, in turns."""
    env = {
        **os.environ,
        "DISPLAY": display,
        "QT_QPA_PLATFORM": "xcb",
        "XDG_STATE_HOME": str(folder),
    }
    found: dict[str, dict[str, list[float]]] = {}
    for _ in range(repeats):
        for path in files:
            for way in WAYS:
                words = [
                    sys.executable,
                    "-m",
                    "benchmarks.viewer_opening",
                    "--child",
                    way,
                    str(path),
                    str(time.time()),
                ]
                done = subprocess.run(
                    words, env=env, cwd=ROOT, capture_output=True, text=True, timeout=300
                )
                if not done.stdout.startswith("painted "):
                    sys.exit(f"no picture: {done.stdout}{done.stderr}")
                wall, own = (round(float(word), 2) for word in done.stdout.split()[1:])
                entry = found.setdefault(f"{way} {path.name}", {"seconds": [], "own_seconds": []})
                entry["seconds"].append(wall)
                entry["own_seconds"].append(own)
    return found


def child(way: str, file: str, began: str) -> None:
    """Open an image; print after how long it was painted, and end."""
    # Loaded when the viewer loads it, no earlier: what is timed is the program as it is.
    import importlib.abc
    import importlib.util

    times = {"began": float(began), "worked": 0.0}

    class Watch(importlib.abc.MetaPathFinder):
        def find_spec(self, name: str, path: object, target: object = None) -> object:
            if name != "accelsurf.viewer.window.desktop":
                return None
            sys.meta_path.remove(self)
            spec = importlib.util.find_spec(name)
            load = spec.loader.exec_module

            def loaded(module: object) -> None:
                load(module)
                watch_paint(module, times)

            spec.loader.exec_module = loaded
            return spec

    sys.meta_path.insert(0, Watch())
    if way == "command":
        sys.argv = ["accelsurf", "view", file]
        from accelsurf.__main__ import main as command

        command()
    in_window(file, times)


def watch_paint(desktop: object, times: dict[str, float]) -> None:
    """End the process when the scene has been painted."""

    class Timed(desktop.QtInteractor):
        def paintGL(self) -> None:
            super().paintGL()
            print(
                "painted",
                time.time() - times["began"],
                time.thread_time() - times["worked"],
                flush=True,
            )
            os._exit(0)

    desktop.QtInteractor = Timed


def in_window(file: str, times: dict[str, float]) -> None:
    """Show the start page, then ask for the file."""
    from PySide6.QtCore import QTimer

    from accelsurf.settings.run_config import RunConfig
    from accelsurf.viewer.actions.opening import Opening
    from accelsurf.viewer.core.recent_files import RecentFiles
    from accelsurf.viewer.window.desktop import application
    from accelsurf.viewer.window.main_window import MainWindow

    app = application()
    opening = Opening(RunConfig(), RecentFiles(None))
    window = MainWindow(opening)
    window.show()

    def ask() -> None:
        times.update(began=time.time(), worked=time.thread_time())
        opening.request("open", file)

    QTimer.singleShot(1500, ask)
    app.exec()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(*sys.argv[2:5])
    else:
        main()
