"""The picture of docs/how-to/track.md: a tracked phantom in the window, prediction beside correction.

Usage: python -m benchmarks.viewer_tasks.sequence_picture FOLDER

Balls that pass each other, of volumes_synth/sequences/balls_passing.toml, so that anybody can make it again.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from benchmarks.viewer_tasks.manual import SIZE, accelsurf
from benchmarks.viewer_tasks.person import ROOT, Person
from tests.support.screen import own_screen

#: The frame that is shown: the velocity is not known yet, so that the prediction is beside the correction.
FRAME = 1


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as home, own_screen(*SIZE) as display:
        accelsurf(
            "synth", str(ROOT / "volumes_synth" / "sequences" / "balls_passing.toml"), "-o", home
        )
        sequence, out = f"{home}/balls_passing.nii.gz", f"{home}/out"
        accelsurf("track", sequence, "-o", out, "--start", "otsu", "--also", "surfaces", "--quiet")
        person = Person(display, Path(home), ["view", sequence, "--tracks", out], size=SIZE)
        person.key(*["period"] * FRAME)
        time.sleep(3.0)
        person.picture(folder / "viewer-frames.png")
        person.close()


if __name__ == "__main__":
    main()
