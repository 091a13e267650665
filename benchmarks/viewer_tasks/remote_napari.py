"""The pictures of docs/how-to/slicer-and-napari.md: the plug-in for nnInteractive in napari, against `accelsurf serve`.

ACCELSURF_VOLUMES=DIR xvfb-run -a -s "-screen 0 1400x900x24" python -m benchmarks.viewer_tasks.remote_napari FOLDER

Needs napari and napari-nninteractive beside accelsurf. The spleen of an abdominal CT is found by a box, and
corrected by points where the labels are most wrong; prints the Dice after each prompt.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

import accelsurf
from benchmarks.clicks.person import next_click
from benchmarks.peers.measure import scans_folder
from tests.support.remote_napari import RemoteNapari

SCAN, SPLEEN = "ct_abdomen_hires", 1
#: Grey values that are shown, HU; middle of the view (y, x), voxels, and its zoom.
WINDOW, ZOOM = (-120.0, 260.0), 1.6
#: Points after the first prompt.
CORRECTIONS = 3


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    scans = scans_folder()
    assert scans is not None, "ACCELSURF_VOLUMES names no folder"
    scan = accelsurf.read(scans / f"{SCAN}.nii.gz")
    truth = accelsurf.read_labels(scans / f"{SCAN}_ref.nii.gz").array == SPLEEN
    z = int(truth.sum((1, 2)).argmax())
    y, x = (places for places in np.nonzero(truth[z]))
    ends = [(z, int(y.min()), int(x.min())), (z, int(y.max()) + 1, int(x.max()) + 1)]
    middle = (z, int(y.mean()), int(x.mean()))
    command = [sys.executable, "-m", "accelsurf", "serve", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().strip()
            driven = RemoteNapari(
                scan.as_float32(), scan.geometry.spacing, address, "", name="abdomen"
            )
            driven.image.contrast_limits = WINDOW
            driven.show(middle)
            driven.look_at(middle, ZOOM)
            driven.choose("box")
            driven.draw([ends[0], middle, ends[1]])
            said("box", driven, truth)
            driven.picture(folder / "napari-remote-box.png")
            for number in range(CORRECTIONS):
                click = next_click(truth, driven.labels > 0, scan.geometry)
                if click is None:
                    break
                driven.choose("point", click.side == "inside")
                driven.show(click.index)
                driven.look_at(click.index, ZOOM)
                driven.draw([click.index])
                said(f"point {number + 1}, {click.side}, at {click.index}", driven, truth)
            driven.picture(folder / "napari-remote-points.png")
            driven.viewer.close()
        finally:
            server.terminate()


def said(name: str, driven: RemoteNapari, truth: np.ndarray) -> None:
    """Print the Dice after a prompt."""
    found = driven.labels > 0
    print(
        f"{name}: {2 * np.count_nonzero(found & truth) / (found.sum() + truth.sum()):.3f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
