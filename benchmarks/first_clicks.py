"""First clicks of any size: how often an answer of another size is named, and what one click finds in even objects.

python -m benchmarks.first_clicks                           phantoms and drawn objects; writes JSON and tables
ACCELSURF_VOLUMES=DIR python -m benchmarks.first_clicks     the scans of the clicks benchmark too
python -m benchmarks.first_clicks --render                  the tables again, from the JSON alone

Each object of `benchmarks.clicks` gets three first clicks at its deepest place: one voxel; the simulated person's ball,
half as deep as the object; and, where a person would seldom make it so large, a ball nearly as deep as the object.

Even objects are drawn in slices and volumes, as masks, clipped and in noise: balls, boxes and lobes, clicked by a
point, a small ball or a short stroke anywhere in them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.model.confidence import confidence_of
from accelsurf.clicks.model.even import BEYOND
from accelsurf.evolution.records import Stop
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.measure.quality import Judged, assess
from accelsurf.run.preprocessing import apply_filters, scale_of
from benchmarks.clicks.folds import PHANTOMS
from benchmarks.clicks.games import SAID, Hints
from benchmarks.clicks.objects import Scene, load, selected
from benchmarks.clicks.own import StartAlone
from benchmarks.clicks.person import PersonClick, next_click, voxels_of
from benchmarks.clicks.references import within
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import scans_folder

ROOT = Path(__file__).resolve().parent.parent
JSON = ROOT / "benchmarks/results/first_clicks.json"
SIZES_PAGE, HOMOGENEOUS_PAGE = (
    ROOT / f"docs/explanation/{name}.md" for name in ("quality", "clicks")
)
#: A large ball is this part of the depth at which it lies.
NEARLY = 0.95
#: An answer is of another size than the object by this factor.
FACTOR = 2.0
#: Even objects of each row: seeds, and pixels or voxels along an axis.
SEEDS, SIDE_2D, SIDE_3D = 18, 160, 56
CLICK_NAMES = {
    "point": "one voxel",
    "person": "ball of half the depth",
    "large": "ball of nearly the depth",
}
DONE = Stop("converged", 0, 0.0, "")
Mask = NDArray[np.bool_]
Row = dict[str, Any]


def first_clicks(scene: Scene) -> Iterator[tuple[str, PersonClick]]:
    """Clicks at the deepest place of an object, by kind."""
    geometry = scene.image.geometry
    ball = next_click(scene.truth, None, geometry)
    assert ball is not None
    yield "person", ball
    yield "point", ball._replace(radius=0.5 * min(geometry.spacing))
    depth = ndimage.distance_transform_edt(scene.truth, sampling=geometry.spacing)[ball.index]
    large = ball._replace(radius=NEARLY * float(depth))
    if large.radius > BEYOND * min(geometry.spacing):
        yield "large", large


def answered(scene: Scene, click: PersonClick) -> Row:
    """The first answer to a click, and what is said of it."""
    image, truth = scene.image, scene.truth
    values = image.as_float32()
    player = StartAlone(image.with_array(apply_filters(values, scale_of(values))), Hints())
    found, voxels = player.click(click), voxels_of(click, image.geometry)
    clicked = np.zeros(truth.shape, np.bool_)
    clicked[voxels.box] = voxels.mask
    assert player.model is not None
    said = assess(
        Judged(
            found.astype(np.uint8),
            player.scene.images[0],
            image.geometry,
            [],
            DONE,
            clicked=clicked,
            confidence=confidence_of(player.model),
        )
    )
    compared = within(found, scene.region)
    return {
        "radius": round(click.radius, 2),
        "dice": round(dice(compared, truth), 4),
        "times": round(float(compared.sum() / truth.sum()), 3),
        "answers": [
            None if each.volume_mm3 is None else round(each.volume_mm3, 1) for each in said.answers
        ],
        "ambiguous": said.is_ambiguous,
        "probability": round(said.probability, 3),
    }


class Homogeneous(NamedTuple):
    """An even object: its image and truth, and what it looks like."""

    scene: Scene
    look: str


def homogeneous_object(is_flat: bool, seed: int) -> Homogeneous:
    """Draw a ball, a box or lobes, turned and stretched, as a mask, clipped or in noise."""
    random = np.random.default_rng([int(is_flat), seed])
    shape = (1, SIDE_2D, SIDE_2D) if is_flat else (SIDE_3D,) * 3
    middle = np.array(shape) * random.uniform(0.4, 0.6, 3)
    turn = np.eye(3)
    axes = slice(1, 3) if is_flat else slice(0, 3)
    turn[axes, axes] = np.linalg.qr(random.standard_normal(turn[axes, axes].shape))[0]
    size = shape[2] * random.uniform(0.12, 0.3) * np.exp(random.uniform(-0.35, 0.35, 3))
    place = np.moveaxis(np.indices(shape), 0, -1) - np.floor(middle)
    along = np.abs(place @ turn.T) / size
    bumps = ndimage.gaussian_filter(random.normal(size=shape), 5.0)
    kind = ("ball", "box", "lobes")[seed % 3]
    if kind == "box":
        truth = along.max(axis=-1) < 1.0
    else:
        bent = 0.15 * bumps / bumps.std() if kind == "lobes" else 0.0
        truth = np.sqrt((along**2).sum(axis=-1)) + bent < 1.0
    parts, count = ndimage.label(truth)
    if count > 1:
        truth = parts == 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    noise, look = random.normal(size=shape), ("mask", "clipped", "noise")[seed // 3 % 3]
    values = {
        "mask": 1.0 * truth,
        "clipped": np.where(truth, 255.0, np.clip(100.0 + 25.0 * noise, 0.0, 254.0)),
        "noise": 100.0 * truth + 15.0 * noise,
    }[look]
    spacing = (4.0, 1.0, 1.0) if is_flat else (1.0, 1.0, 1.0)
    return Homogeneous(
        Scene(Volume.from_array(values.astype(np.float32), spacing), truth), f"{look}, {kind}"
    )


def homogeneous_clicks(scene: Scene, seed: int) -> Iterator[tuple[str, PersonClick]]:
    """A point, a small ball and a short stroke anywhere in an object, but for its rim."""
    random = np.random.default_rng(seed)
    deep = ndimage.distance_transform_edt(scene.truth, sampling=scene.image.geometry.spacing)
    z, y, x = (int(i) for i in random.choice(np.argwhere(deep > min(3.0, 0.6 * deep.max()))))
    wx, wy, wz = (float(v) for v in scene.image.geometry.index_to_world((z, y, x)))
    point = PersonClick("inside", (z, y, x), (wx, wy, wz), 0.5)
    yield "point", point
    yield "ball of 2 voxels", point._replace(radius=2.0)
    length = int(random.integers(5, 10))
    ends = range(x - length // 2, x - length // 2 + length)
    line = tuple((z, y, i) for i in ends if 0 <= i < scene.truth.shape[2] and scene.truth[z, y, i])
    yield "stroke of 5 to 9 voxels", point._replace(line=line)


def text_of_sizes(rows: list[Row]) -> str:
    """The table of answers of another size."""
    lines = head_of(
        (
            "first click",
            "objects",
            "mean Dice",
            "ambiguous",
            f"of these said to be good ({SAID:.0%})",
            f"{FACTOR:g} times too large, too small",
            "of these ambiguous",
            "of these with at most 50%",
            "of these said to be good",
        )
    )
    parts: dict[str, Callable[[Row], bool]] = {
        "scans": lambda row: row["fold"] != PHANTOMS,
        "phantoms": lambda row: row["fold"] == PHANTOMS,
    }
    for part, belongs in parts.items():
        for kind, name in CLICK_NAMES.items():
            here = [row for row in rows if belongs(row) and row["click"] == kind]
            if not here:
                continue
            times = np.array([row["times"] for row in here])
            named = np.array([row["ambiguous"] for row in here])
            probabilities = np.array([row["probability"] for row in here])
            off = (times >= FACTOR) | (times <= 1.0 / FACTOR)
            counts = (
                int(named.sum()),
                int((probabilities[named] >= SAID).sum()),
                f"{int((times >= FACTOR).sum())}, {int((times <= 1.0 / FACTOR).sum())}",
                int(named[off].sum()),
                int((probabilities[off] <= 0.5).sum()),
                int((probabilities[off] >= SAID).sum()),
            )
            mean = np.mean([row["dice"] for row in here])
            cells = (f"{part}: {name}", str(len(here)), f"{mean:.3f}", *map(str, counts))
            lines.append(row_of(cells))
    return "\n".join(lines) + "\n"


def text_of_homogeneous(rows: list[Row]) -> str:
    """The table of even objects."""
    lines = head_of(
        ("even objects", "click", "objects", "median Dice", "least Dice", "above .9", "ambiguous")
    )
    for part in ("2D", "3D"):
        for kind in dict.fromkeys(row["click"] for row in rows):
            here = [row for row in rows if (row["part"], row["click"]) == (part, kind)]
            found = np.array([row["dice"] for row in here])
            cells = (
                part,
                kind,
                str(len(here)),
                f"{np.median(found):.3f}",
                f"{found.min():.3f}",
                f"{np.mean(found > 0.9):.0%}",
                str(sum(row["ambiguous"] for row in here)),
            )
            lines.append(row_of(cells))
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write JSON and tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.first_clicks", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--volumes", type=Path, default=scans_folder(), help="folder of the scans")
    parser.add_argument("--render", action="store_true", help="measure nothing")
    options = parser.parse_args(arguments)
    if options.render:
        results = json.loads(JSON.read_text())
    else:
        results = measure(options.volumes)
        JSON.write_text(json.dumps(results, indent=1) + "\n")
    put_table(SIZES_PAGE, "benchmarks.first_clicks", text_of_sizes(results["sizes"]), "python -m")
    put_table(
        HOMOGENEOUS_PAGE,
        "benchmarks.first_clicks",
        text_of_homogeneous(results["even"]),
        "python -m",
    )
    return 0


def measure(folder: Path | None) -> dict[str, list[Row]]:
    """Make the rows."""
    results: dict[str, list[Row]] = {"even": [], "sizes": []}
    for part in ("2D", "3D"):
        for seed in range(SEEDS):
            drawn = homogeneous_object(part == "2D", seed)
            for kind, click in homogeneous_clicks(drawn.scene, seed):
                about = {"part": part, "seed": seed, "look": drawn.look, "click": kind}
                results["even"].append({**about, **answered(drawn.scene, click)})
                print(results["even"][-1], flush=True)
    for which in selected([] if folder is not None else [PHANTOMS]):
        scene = load(which, folder)
        about = {"object": which.name, "fold": which.fold, "family": which.family}
        for kind, click in first_clicks(scene):
            results["sizes"].append({**about, "click": kind, **answered(scene, click)})
            print(results["sizes"][-1], flush=True)
    return results


if __name__ == "__main__":
    sys.exit(main())
