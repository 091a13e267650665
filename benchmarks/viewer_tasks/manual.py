"""The pictures of docs/how-to/viewer.md: scene, window while a run runs, after a stroke, keys, and page.

Usage: python -m benchmarks.viewer_tasks.manual FOLDER

The scan is the vessel of volumes_synth/vessel.toml, so that anybody can make them again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

from accelsurf import io
from benchmarks.viewer_tasks.person import ROOT, Person
from benchmarks.viewer_tasks.pictures import page_of, take_page, wait
from tests.support.screen import own_screen

SIZE = (1280, 720)
#: Steps after which the run is paused.
STEPS = 60


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as home:
        recipe = ROOT / "volumes_synth" / "vessel.toml"
        accelsurf("synth", str(recipe), "-o", home)
        image = Path(home) / "vessel.nii.gz"
        truth = Path(home) / "vessel_truth.nii.gz"
        words = ["view", str(image), "--reference", str(truth), "--levels", "1"]
        movie = ["movie", *words[1:], "--preview", "-o", str(folder / "viewer-scene.png"), "--overwrite"]
        accelsurf(*movie, "--max-steps", str(STEPS))
        window_pictures(words, truth, folder)
        with page_of(words, "dark", Path(home)) as browser:
            browser.find_element("id", "play").click()
            wait(lambda: int(browser.find_element("id", "step").text.split()[1]) >= STEPS, 300)
            browser.find_element("id", "play").click()
            take_page(browser, *SIZE, folder / "viewer-browser.png")


def accelsurf(*words: str) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "accelsurf", *words], check=True, cwd=ROOT)


def window_pictures(words: list[str], truth: Path, folder: Path) -> None:
    """The scene alone, the window while a run runs, its keys, and the window after a stroke."""
    for theme in ("dark", "light"):
        with tempfile.TemporaryDirectory() as home, own_screen(*SIZE) as display:
            person = Person(display, Path(home), [*words, "--theme", theme, "--output", home], size=SIZE)
            person.key("space")
            person.until(lambda now: now["step"] >= STEPS or now["stop"], 300)
            if theme == "dark":
                person.picture(folder / "viewer-run.png")
                person.key("space", "F1")
                time.sleep(2.0)
                person.picture(folder / "viewer-help.png")
                person.key("Escape")
            else:
                person.until(lambda now: not now["playing"], 300)
                stroke(person, thick_place(truth))
                person.picture(folder / "viewer-edit.png")
            person.close()


def thick_place(truth: Path) -> np.ndarray:
    """The place deepest in the vessel, (x, y, z) mm."""
    labels = io.read_labels(truth)
    depth = ndimage.distance_transform_edt(labels.array)
    place = np.unravel_index(int(depth.argmax()), depth.shape)
    return np.asarray(labels.geometry.index_to_world(np.array([place], float))[0])


def stroke(person: Person, place: np.ndarray) -> None:
    """Move the slices to a place, and paint what is outside beside it in the coronal slice."""
    person.click(person.pixel("sagittal", (0.0, place[1], place[2])))
    person.click(person.pixel("coronal", place))
    person.key("o")
    person.drag([person.pixel("coronal", place + (13.0, 0.0, z)) for z in (-4.0, -2.0, 0.0, 2.0)])
    person.until(lambda now: now["refinements"] > 0 and "correcting" not in now["message"], 120)
    time.sleep(2.0)


if __name__ == "__main__":
    main()
