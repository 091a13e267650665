"""Segments real objects in the window by the mouse alone, and counts actions and seconds.

Usage: python -m benchmarks.viewer_tasks.run VOLUMES_FOLDER [TASK ...] [-o benchmarks/results/viewer_tasks.json]
           [--pictures FOLDER] [--size 1920x1080] [--words "--mesh stl"] [--strokes 5]

The command is ``accelsurf view -o FOLDER`` and nothing else. A simulated person chooses the scan among the recent
images, knows the object from a reference, as somebody does who knows anatomy, and acts as one could: the wheel brings
the thickest place of the object into sight, a press there and a drag until the outline has the right size, strokes
(five for each object at most) where the object that fits least is wrong most. Then STL is selected beside *Save*, and
*Save* is clicked; the table of statistics in the folder has the volumes. Then run.toml is run by ``accelsurf segment``,
which must make the same bytes. Scans are public: see benchmarks/README.md; the three nuclei that touch are a phantom.
An earlier version, in which STL could not be selected by the mouse, gets it by --words.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import json
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf import cli, io
from accelsurf.grid.geometry import Geometry
from benchmarks.viewer_tasks.person import ROOT, GaveUp, Person
from benchmarks.viewer_tasks.touching import touching_nuclei
from tests.support.screen import own_screen

#: Strokes at most after the first result, and the Dice at which a person is content.
MAX_STROKES, CONTENT = 5, 0.93


class Task(NamedTuple):
    """What is to be segmented: scan, reference, the ids of each object in it; without a scan it is the phantom."""

    scan: str
    reference: str
    labels: str


TASKS = {
    "liver": Task("ct_abdomen_hires.nii.gz", "ct_abdomen_hires_ref.nii.gz", "5"),
    "ventricle": Task("mri_brain256.nii.gz", "mri_brain256_ref.nii.gz", "4"),
    "touching nuclei": Task("", "", "1;2;3"),
    "nuclei": Task("fluo_nuclei1136.nii.gz", "fluo_nuclei1136_ref.nii.gz", "neighbours"),
}
#: Nuclei of the real scan are neighbours at this many voxels: its reference has two pairs that share a face, and no
#: three; at fewer voxels than these there are none either.
NEAR = 3


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("volumes", type=Path)
    options.add_argument("tasks", nargs="*", choices=[*TASKS, []], default=[])
    options.add_argument("--size", default="1920x1080")
    options.add_argument("--pictures", type=Path)
    options.add_argument("--words", default="")
    options.add_argument("--strokes", type=int, default=MAX_STROKES)
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/viewer_tasks.json"
    )
    given = options.parse_args()
    width, height = (int(side) for side in given.size.split("x"))
    results = {}
    with own_screen(width, height) as display:
        for name in given.tasks or TASKS:
            with tempfile.TemporaryDirectory() as folder:
                size, words = (width, height), given.words.split()
                work = (
                    TASKS[name],
                    given.volumes,
                    display,
                    Path(folder),
                    given.pictures,
                    size,
                    words,
                    given.strokes,
                )
                results[name] = do_task(name, *work)
            print(name, json.dumps(results[name]), flush=True)
            known = json.loads(given.output.read_text()) if given.output.exists() else {}
            given.output.parent.mkdir(parents=True, exist_ok=True)
            given.output.write_text(json.dumps({**known, **results}, indent=2) + "\n")


def do_task(
    name: str,
    task: Task,
    volumes: Path,
    display: str,
    folder: Path,
    pictures: Path | None,
    size: tuple[int, int],
    words: list[str],
    strokes: int,
) -> dict[str, Any]:
    """Do a task; returns what it took and what came of it."""
    scan, reference = volumes / task.scan, volumes / task.reference
    if not task.scan:
        scan, reference = touching_nuclei(folder)
    truth = io.read_labels(reference)
    labels = three_neighbours(truth.array) if task.labels == "neighbours" else task.labels
    objects = [
        np.isin(truth.array, [int(one) for one in ids.split(",")]) for ids in labels.split(";")
    ]
    voxel = float(np.prod(truth.geometry.spacing))
    recent = folder / "accelsurf"
    recent.mkdir()
    (recent / "recent.json").write_text(json.dumps([str(scan.absolute())]))
    person = Person(
        display, folder, ["view", "-o", str(folder / "out"), *words], reference, labels, size
    )
    person.open_recent()
    for number, wanted in enumerate(objects):
        begin_object(person, number, wanted, truth.geometry, float(wanted.sum() * voxel))
    first_s, judged_s = time.monotonic() - person.began, 0.0
    dice, obeyed = [], []
    while True:
        began = time.monotonic()
        seen = person.judge()
        judged_s += time.monotonic() - began  # a person sees it
        dice.append(seen["dice"])
        small = seen["worst"]["depth"] < 1.5 * max(truth.geometry.spacing)
        if min(seen["dice"]) >= CONTENT or small or len(obeyed) == strokes * len(objects):
            break
        obeyed.append(correct(person, seen["worst"]))
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        person.picture(pictures / f"task-{name}.png")
    save_stl(person)
    seconds, actions = time.monotonic() - person.began - judged_s, person.actions
    person.close()
    return {
        "actions": actions,
        "seconds": round(seconds, 1),
        "opened_s": round(person.opened_s, 1),
        "first_result_s": round(first_s, 1),
        "dice": dice,
        "strokes": len(obeyed),
        "obeyed_s": obeyed,
        "ml": saved_ml(folder / "out"),
        "ml_reference": [round(float(one.sum()) * voxel / 1000, 6) for one in objects],
        "files": sorted(path.name for path in (folder / "out").iterdir()),
        "same_bytes": same_bytes(scan, folder),
    }


def save_stl(person: Person) -> None:
    """Choose STL, where it is not selected by the command, and save all."""
    if "format of the mesh" in person.now()["widgets"]:
        person.choose("format of the mesh", "stl")
        person.until(lambda now: now["state"]["mesh"] == "stl", 20)
    person.click_widget("Save")
    person.until(lambda now: "saved " in now["message"] and not now["state"]["saving"], 300)


def three_neighbours(labels: np.ndarray) -> str:
    """Ids of the nucleus with the most voxels among those with two neighbours, and of these two."""
    ids, counts = np.unique(labels[labels > 0], return_counts=True)
    volumes, found = dict(zip(ids.tolist(), counts.tolist(), strict=True)), []
    for own in volumes:
        around = (
            ndimage.binary_dilation(labels == own, np.ones((3, 3, 3)), NEAR)
            & (labels != own)
            & (labels > 0)
        )
        others, voxels = np.unique(labels[around], return_counts=True)
        if len(others) > 1:
            nearest = [int(others[place]) for place in np.argsort(-voxels)[:2]]
            found.append((volumes[own], [own, *nearest]))
    return ";".join(str(one) for one in max(found)[1])


def begin_object(
    person: Person, number: int, wanted: np.ndarray, geometry: Geometry, mm3: float
) -> None:
    """Press at the thickest place of an object, draw its size out, and let the surface run to its end."""
    depth = ndimage.distance_transform_edt(wanted, sampling=geometry.spacing)
    place = geometry.index_to_world(
        np.array(np.unravel_index(int(depth.argmax()), depth.shape), float)
    )
    show(person, place)
    before = person.now()
    if number:
        person.click_widget("Add")
    draw_size(person, place, mm3)
    person.until(lambda now: now["undoable"] > before["undoable"], 300)
    # The run plays from the release on; a key for it would pause it. A further object is a correction.
    person.until(
        lambda now: now["stop"] is not None and not now["playing"] and has_begun(now, number), 600
    )


def has_begun(now: dict[str, Any], number: int) -> bool:
    """Whether an object has its surface."""
    rows = now["state"]["object_rows"]
    return (
        len(rows) > number
        and all(row["volume"] for row in rows)
        and "correcting" not in now["message"]
    )


def show(person: Person, world: np.ndarray) -> None:
    """Bring a place into sight: the wheel over the axial slice."""
    seen = person.now()
    (now, count), wanted = seen["state"]["slices"]["axial"], seen["place_of_slices"]
    slope, first = wanted
    notches = round(first + slope * float(world[2])) + 1 - now
    if notches:
        person.scroll(
            seen["tiles"]["axial"]["middle"], 4 if (notches > 0) == (slope > 0) else 5, abs(notches)
        )
        person.until(
            lambda seen: (
                abs(seen["state"]["slices"]["axial"][0] - min(max(now + notches, 1), count)) < 2
            ),
            20,
        )


def use(person: Person, tool: str) -> None:
    """Have a tool in hand."""
    if person.now()["state"]["tool"] != tool.lower():
        person.click_widget(tool)
        person.until(lambda now: now["state"]["tool"] == tool.lower(), 20)


def draw_size(person: Person, place: np.ndarray, mm3: float) -> None:
    """Press at a place, and drag until the outline has the size of the object."""
    use(person, "Size")
    start = person.pixel("axial", place)
    # One looks at the outline while one drags: it is waited for, and no further than a ball of twice the size.
    radius = (6.0 * mm3 / np.pi) ** (1 / 3) / 2
    way = person.pixel("axial", place + [radius, 0.0, 0.0]) - start
    shares = np.arange(0.1, 1.6, 0.03)
    shown = 0.0

    def is_large() -> bool:
        nonlocal shown
        before = shown
        with contextlib.suppress(GaveUp):  # a move of less than a pixel changes nothing
            person.until(lambda now: size_in(now) != before, 10)
        shown = size_in(person.now())
        return shown >= 0.97 * mm3

    person.drag([start, *(start + share * way for share in shares)], stop=is_large)


def size_in(now: dict[str, Any]) -> float:
    """The size that is written beside the outline, mm3."""
    written = now["titles"]["axial"].partition("size ")[2].partition(" mm3")[0].replace(" ", "")
    return float(written) if written else 0.0


def correct(person: Person, worst: dict[str, Any]) -> float:
    """A stroke where the surface is wrong most; returns the seconds until the surface was drawn that obeys."""
    if (
        len(person.now()["object_rows"]) > 1
        and person.now()["state"]["object_active"] != worst["object"] + 1
    ):
        person.click(
            person.now()["object_rows"][worst["object"]]
        )  # strokes are for the row that is selected
    show(person, np.array(worst["world"]))
    use(person, "Inside" if worst["side"] == "inside" else "Outside")
    x, y = person.pixel("axial", worst["world"])
    before = person.now()
    person.drag([(x - 3, y), (x, y), (x + 3, y)])
    began = time.monotonic()
    person.until(lambda now: now["undoable"] > before["undoable"] and answered(now, before), 60)
    return round(time.monotonic() - began, 2)


def answered(now: dict[str, Any], before: dict[str, Any]) -> bool:
    """Whether the surface has obeyed a stroke, or the window says that nothing was to be changed."""
    return bool(now["drawn"] != before["drawn"]) or "nothing changed" in now["message"]


def saved_ml(folder: Path) -> list[float]:
    """The volume of each object that the saved table says."""
    (table,) = folder.glob("*_statistics.csv")
    with open(table, newline="") as lines:
        return [round(float(line["volume_mm3"]) / 1000.0, 6) for line in csv.DictReader(lines)]


def same_bytes(scan: Path, folder: Path) -> bool:
    """Whether the saved run.toml makes the same label map and mesh from the command line."""
    config = next((folder / "out").glob("*_run.toml"))
    words = ["segment", str(scan), "--config", str(config), "-o", str(folder / "again"), "--quiet"]
    if cli.execute(words):
        return False
    names = [
        path.name
        for path in (folder / "out").iterdir()
        if "_seg" in path.name or "_surface" in path.name
    ]
    return bool(names) and all(
        digest(folder / "out" / name) == digest(folder / "again" / name) for name in names
    )


def digest(path: Path) -> str:
    """SHA-256 of a file; none for a missing one."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


if __name__ == "__main__":
    main()
