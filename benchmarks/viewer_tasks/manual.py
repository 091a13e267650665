"""The pictures of docs/how-to/viewer.md: scene, window when opened, with a result, after a stroke, keys, and page.

Usage: python -m benchmarks.viewer_tasks.manual FOLDER

The scan is the phantom of volumes_synth/two_balls.toml, so that anybody can make them again.
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
from benchmarks.viewer_tasks.pictures import click_in_axial, has_ended, page_of, take_page, wait
from tests.support.screen import own_screen

SIZE = (1280, 720)
#: Steps after which the run is paused.
STEPS = 60


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as home:
        recipe = ROOT / "volumes_synth" / "two_balls.toml"
        accelsurf("synth", str(recipe), "-o", home)
        image = Path(home) / "two_balls.nii.gz"
        truth = Path(home) / "two_balls_truth.nii.gz"
        words = ["view", str(image), "--levels", "1"]
        movie = [
            "movie",
            *words[1:],
            "--reference",
            str(truth),
            "--preview",
            "--max-steps",
            str(STEPS),
        ]
        accelsurf(*movie, "-o", str(folder / "viewer-scene.png"), "--overwrite")
        window_pictures(words, truth, folder)
        with page_of(words, "dark", Path(home)) as browser:
            browser.set_window_size(*SIZE)
            time.sleep(3.0)
            click_in_axial(browser, Path(home) / "page.json")
            wait(lambda: has_ended(browser), 300)
            take_page(browser, *SIZE, folder / "viewer-browser.png")


def accelsurf(*words: str) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "accelsurf", *words], check=True, cwd=ROOT)


def window_pictures(words: list[str], truth: Path, folder: Path) -> None:
    """The window when it is opened, with the result of a press and a drag, its keys; and after a stroke."""
    for theme in ("dark", "light"):
        with tempfile.TemporaryDirectory() as home, own_screen(*SIZE) as display:
            person = Person(
                display, Path(home), [*words, "--theme", theme, "--output", home], size=SIZE
            )
            person.until(lambda now: now["state"]["ready"], 120)
            time.sleep(2.0)
            if theme == "dark":
                person.picture(folder / "viewer-opened.png")
            press(person, thick_place(truth))
            if theme == "dark":
                person.picture(folder / "viewer-run.png")
                person.key("F1")
                time.sleep(2.0)
                person.picture(folder / "viewer-help.png")
                person.key("Escape")
            else:
                stroke(person, thick_place(truth))
                person.picture(folder / "viewer-edit.png")
            person.close()


def thick_place(truth: Path) -> np.ndarray:
    """The place deepest in an object, (x, y, z) mm."""
    labels = io.read_labels(truth)
    depth = ndimage.distance_transform_edt(labels.array)
    place = np.unravel_index(int(depth.argmax()), depth.shape)
    return np.asarray(labels.geometry.index_to_world(np.array([place], float))[0])


def press(person: Person, place: np.ndarray) -> None:
    """Move the slices to a place, press there and draw the size out; wait for the end of the run."""
    person.key("v")
    for tile in ("sagittal", "coronal"):
        person.click(person.pixel(tile, place))
    person.key("s")
    way = [
        person.pixel("axial", place + (right, 0.0, 0.0)) for right in (0.0, 4.0, 8.0, 12.0, 16.0)
    ]
    person.drag(way)
    person.until(lambda now: now["stop"] is not None and not now["playing"], 300)
    person.until(lambda now: now["state"]["uncertain"] or now["state"]["result"], 60)
    time.sleep(4.0)


def stroke(person: Person, place: np.ndarray) -> None:
    """Paint what is inside, around the mirrored place in the coronal slice: the other ball."""
    person.key("i")
    other = place * (-1.0, 1.0, 1.0)
    person.drag([person.pixel("coronal", other + (x, 0.0, 0.0)) for x in (-6.0, -2.0, 2.0, 6.0)])
    person.until(lambda now: now["refinements"] > 0 and "correcting" not in now["message"], 120)
    time.sleep(4.0)


if __name__ == "__main__":
    main()
