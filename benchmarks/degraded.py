"""Real scans made worse by their own physics: where momentum decides against descent, and against other methods.

    python -m benchmarks.degraded [--minutes N] [--tables]

makes docs/explanation/noise.md: tables, figure, and benchmarks/results/degraded.json with every run; runs that the JSON
has are not made again. The scans are those of `benchmarks.clicks`, in the folder ACCELSURF_VOLUMES.

**Object.** The crop is an object's box, 15 % wider on each side. Of a scan's objects in the click benchmark's table
with `LEAST` voxels or more, whose mean is a deviation or more apart from that of the rest of the crop (a surface
between two means finds no other), the one with the strongest edge; on a grid restricted to at most `MOST` voxels.

**Noise.** Full exposure is the scan as it is, or one with noise of a quarter of the contrast where it has less. At 1/k
of the exposure the variance is k times as large: Rician in MR; Poisson counts in projections with electronic noise,
reconstructed by filtered backprojection, in CT; Poisson counts per voxel in fluorescence. No scan is of ultrasound.

**Runs.** From a ball in the deepest place, and from a click there. Flows: `segment` to the stop rule, one step control,
one thread. Settings are selected by mean Dice on half of the bodies, at the full exposure and at 1/16, and reported on
the other half. Flows from a click have nothing to choose: the program does it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import segment
from accelsurf.errors import AccelsurfError
from accelsurf.grid.boxes import bounding_box, common, connected_to, widened
from accelsurf.image.blocks import block_means, coarsening
from accelsurf.image.noise import noise_of
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.run.preprocessing import scale_of
from accelsurf.settings.run_config import RunConfig
from benchmarks.clicks.domain import CroppedSession
from benchmarks.clicks.folds import FOLDS
from benchmarks.clicks.measures import surfaces
from benchmarks.clicks.objects import Scene, load, selected
from benchmarks.clicks.peers import PEERS
from benchmarks.clicks.person import PersonClick, ball_voxels, next_click
from benchmarks.clicks.references import edge
from benchmarks.cuts import least_cut, pairs_of
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import combinations

ROOT = Path(__file__).resolve().parent.parent
PAGE, RESULTS = (
    ROOT / "docs" / "explanation" / "noise.md",
    ROOT / "benchmarks" / "results" / "degraded.json",
)
PICTURE, COMMAND = ROOT / "docs" / "figures" / "noise.png", "python -m benchmarks.degraded"
#: Scans without an object that is large enough and apart from its surroundings.
NONE = ("mri_cord_iso", "mri_cord_thick", "mri_tumour_thick2")
LEAST, APART, MOST, MARGIN = 1000, 1.0, 80_000, 0.15
#: Noise of full exposure, in parts of the contrast, where the scan has less.
FULL = 0.25
#: Parts of the full exposure; 1 is the scan as it is.
EXPOSURES = (1, 4, 16, 64)
#: For each, in the order of the runs, the exposure that settings are selected at.
SELECTED_AT = {16: 16, 64: 16, 1: 1, 4: 1}
#: The folds that settings are selected on; the others, which have no body in common with them, are reported.
TUNED = ("1", "2", "4")
#: Ray that is absorbed most, in e-folds; views over half a turn; electronic noise of a detector, in quanta.
ABSORBED, VIEWS, ELECTRONIC = 4.0, 180, 5.0
#: So many steps are not reached.
MAX_STEPS = 20_000
#: Settings that are no choice.
FIXED = ("reach", "implied")
MOMENTUM, DESCENT = "momentum", "descent"
#: Takes as long as all others together.
SLOW = "Sobolev"
FLOWS = {
    MOMENTUM: "constant-density",
    DESCENT: "gradient",
    "heavy ball": "momentum",
    SLOW: "sobolev",
}
BALL, CLICK = "ball", "click"
COLOURS = "#D55E00", "#0072B2", "#E69F00", "#CC79A7", "#009E73", "#56B4E9", "0.55"
#: Dice within which two methods are level.
LEVEL = 0.01
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]
Settings = Mapping[str, Any]
Results = dict[str, Any]


class Crop(NamedTuple):
    """An object in its crop: values, truth, spacing (z, y, x), contrast (`difference`) and noise."""

    name: str
    values: Array
    truth: Mask
    spacing: tuple[float, float, float]
    contrast: float
    noise: float

    @property
    def image(self) -> Volume:
        """The values as an image."""
        return Volume.from_array(self.values, self.spacing)


# -- scans ---------------------------------------------------------------------------------------------------


def scans(is_tuned: bool) -> list[str]:
    """The scans of a half that have an object, in order."""
    folds = [fold.name for fold in FOLDS if (fold.name in TUNED) == is_tuned]
    return [
        name for name in dict.fromkeys(each.volume for each in selected(folds)) if name not in NONE
    ]


def cropped(scene: Scene) -> tuple[Array, Mask]:
    """Values and truth in the box of an object, widened."""
    box = bounding_box(scene.truth)
    assert box is not None  # an object has voxels
    margin = [max(3, round(MARGIN * (side.stop - side.start))) for side in box]
    wide = widened(box, scene.truth.shape, (margin[0], margin[1], margin[2]))
    if scene.region is not None:
        wide = common(wide, scene.region)
    return np.asarray(scene.image.array[wide], np.float32), scene.truth[wide]


@lru_cache(maxsize=32)
def crop_of(scan: str) -> Crop:
    """The crop that the rule takes of a scan."""
    strongest = 0.0
    for which in (each for each in selected() if each.volume == scan):
        scene = load(which)
        values, truth = cropped(scene)
        apart = abs(difference(values, truth)) / np.sqrt(
            0.5 * (values[truth].var() + values[~truth].var())
        )
        if (
            truth.sum() >= LEAST
            and apart >= APART
            and (strength := edge(values, truth)) > strongest
        ):
            strongest = strength
            found = (which.name, values, truth)
            spacing = scene.image.geometry.spacing
    name, values, truth = found
    steps = coarsening(values.shape, spacing, MOST)
    values, truth = block_means(values, steps), block_means(truth.astype(np.float32), steps) >= 0.5
    mm = (spacing[0] * steps[0], spacing[1] * steps[1], spacing[2] * steps[2])
    return Crop(name, values, truth, mm, difference(values, truth), noise_of(values))


def difference(values: Array, truth: Mask) -> float:
    """Mean of an object less that of the rest of its crop."""
    return float(values[truth].mean() - values[~truth].mean())


# -- noise ---------------------------------------------------------------------------------------------------


def degraded(crop: Crop, scan: str, part: int) -> Crop:
    """The crop at 1/``part`` of the full exposure."""
    if part == 1:
        return crop
    random = np.random.default_rng(zlib.crc32(f"{scan} {part}".encode()))
    sigma = max(crop.noise, FULL * abs(crop.contrast)) * (part - 1) ** 0.5
    make = {"mr": rician, "ct": projected, "fl": counted, "sy": counted}[scan[:2]]
    values = make(crop.values - crop.values.min(), sigma, random).astype(np.float32)
    added = float(np.std(values - (crop.values - crop.values.min())))
    return crop._replace(values=values, noise=float(np.hypot(crop.noise, added)))


def rician(values: Array, sigma: float, random: np.random.Generator) -> NDArray[Any]:
    """Magnitude of a signal with noise in its real and its imaginary part."""
    return np.hypot(
        values + random.normal(0.0, sigma, values.shape), random.normal(0.0, sigma, values.shape)
    )


def counted(values: Array, sigma: float, random: np.random.Generator) -> NDArray[Any]:
    """Photon counts: noise ``sigma`` where the crop has its mean."""
    photon = sigma**2 / float(values.mean())
    return photon * random.poisson(values / photon)


def projected(values: Array, sigma: float, random: np.random.Generator) -> NDArray[Any]:
    """Values with the noise of quanta and detectors, slice by slice; mean noise ``sigma`` before the electronic one."""
    from skimage.transform import iradon, radon

    side = max(values.shape[1:])
    square = np.zeros((len(values), side, side))
    square[:, : values.shape[1], : values.shape[2]] = values
    angles = np.linspace(0.0, 180.0, VIEWS, endpoint=False)
    rays = np.stack([radon(each, angles, circle=False) for each in square])
    scale = ABSORBED / rays.max()

    def back(rays: NDArray[Any]) -> NDArray[Any]:
        slices = np.stack([iradon(each, angles, output_size=side, circle=False) for each in rays])
        return slices[:, : values.shape[1], : values.shape[2]] / scale

    arriving = np.exp(-scale * rays)
    unit = float(np.std(back(random.normal(size=rays.shape) / np.sqrt(arriving))))
    emitted = (unit / sigma) ** 2
    counts = random.poisson(emitted * arriving) + random.normal(0.0, ELECTRONIC, rays.shape)
    return values + back(-np.log(np.maximum(counts, 1.0) / emitted) - scale * rays)


# -- methods -------------------------------------------------------------------------------------------------


def smoothed(crop: Crop, sigma: float) -> Array:
    """Values under a Gaussian of so many of the smallest spacing."""
    return ndimage.gaussian_filter(
        crop.values, [sigma * min(crop.spacing) / h for h in crop.spacing]
    )


def total_variation(crop: Crop, weight: float) -> Array:
    """Values without noise; the weight is in contrasts."""
    from skimage.restoration import denoise_tv_chambolle

    unit = abs(crop.contrast)
    return np.asarray(
        denoise_tv_chambolle(crop.values / unit, weight, max_num_iter=100) * unit, np.float32
    )


def seeds_of(crop: Crop, click: PersonClick) -> NDArray[np.int32]:
    """2 on the crop's faces, 1 in the ball, 0 elsewhere."""
    seeds = np.pad(np.zeros([n - 2 for n in crop.truth.shape], np.int32), 1, constant_values=2)
    box, ball = ball_voxels(click, crop.image.geometry)
    seeds[box][ball] = 1
    return seeds


def random_walker(crop: Crop, click: PersonClick, settings: Settings) -> Mask:
    """Random walks from the ball and from the crop's faces, after a Gaussian."""
    from skimage.segmentation import random_walker as walk

    relative = np.array(crop.spacing) / min(crop.spacing)
    values = smoothed(crop, settings["sigma"]) / abs(crop.contrast)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says where a probability is beyond 1 by its tolerance
        found = walk(
            values, seeds_of(crop, click), settings["beta"], mode="cg_j", tol=1e-3, spacing=relative
        )
    return np.asarray(found == 1)


def graph_cut(crop: Crop, click: PersonClick, settings: Settings) -> Mask:
    """The least of |I - mean|^2 and the weighted area: Chan and Vese's energy, with the means of the last cut.

    Those of the first cut are the ball's and the rest's.
    """
    values = smoothed(crop, settings["sigma"])
    ball, scale = seeds_of(crop, click) == 1, 1e3
    links = [
        (
            first,
            other,
            np.full(
                first.size, round(scale * settings["weight"] * min(crop.spacing) / h), np.int32
            ),
        )
        for (first, other), h in zip(pairs_of(crop.truth.shape), crop.spacing, strict=True)
    ]
    found = ball
    for _ in range(settings["cuts"]):
        inside, outside = (float(values[side].mean()) for side in (found, ~found))
        cost = ((values - inside) ** 2 - (values - outside) ** 2) / (inside - outside) ** 2
        cost[ball] = -scale
        ends = np.round(scale * np.clip(cost, -scale, scale)).astype(np.int32).ravel()
        cut = least_cut(np.maximum(-ends, 0), np.maximum(ends, 0), links).reshape(crop.truth.shape)
        before, found = found, connected_to(cut, ball)
        if (found == before).all() or found.all():
            break
    return found


def tv_threshold(crop: Crop, click: PersonClick, settings: Settings) -> Mask:
    """Total variation, Otsu's threshold, the part with the ball, its holes filled; told that the object is bright."""
    from skimage.filters import threshold_otsu

    values = total_variation(crop, settings["weight"]) * np.float32(np.sign(crop.contrast))
    found = connected_to(values > threshold_otsu(values), seeds_of(crop, click) == 1)
    return np.asarray(ndimage.binary_fill_holes(found))


def clicked(peer: str) -> Callable[[Crop, PersonClick, Settings], Mask]:
    """A method of the click benchmark, on the smoothed image."""

    def run(crop: Crop, click: PersonClick, settings: Settings) -> Mask:
        options = dict(settings)
        weight, sigma = options.pop("tv", 0.0), options.pop("sigma", 0.0)
        values = (
            total_variation(crop, weight)
            if weight
            else smoothed(crop, sigma)
            if sigma
            else crop.values
        )
        return CroppedSession(
            crop.image.with_array(values), PEERS[peer].solver, options, PEERS[peer].cap
        ).click(click)

    return run


class Method(NamedTuple):
    """A method: how it is run (None: as a flow), and the settings to choose from."""

    run: Callable[[Crop, PersonClick, Settings], Mask] | None
    grid: list[dict[str, Any]]


FLOW_GRID: list[dict[str, Any]] = [{}, {"presmooth": 1, "area": 0.1}, {"presmooth": 2}]
IMPLIED = {"implied": (1,), "sigma": (0, 1, 2)}
METHODS: dict[str, dict[str, Method]] = {
    BALL: {
        **{name: Method(None, FLOW_GRID) for name in FLOWS},
        "random walker": Method(
            random_walker, combinations(sigma=(0.7, 1.0, 2.0), beta=(300.0, 3000.0))
        ),
        "graph cut": Method(
            graph_cut, combinations(sigma=(0, 1, 2), weight=(0.3, 1.0, 3.0), cuts=(1, 3))
        ),
        "total variation": Method(tv_threshold, combinations(weight=(0.15, 0.5, 1.0, 2.0, 4.0))),
    },
    CLICK: {
        **{name: Method(None, [{}]) for name in FLOWS},
        "random walker": Method(
            clicked("random-walker"), combinations(reach=(4.0,), beta=(100.0,), **IMPLIED)
        ),
        "graph cut": Method(
            clicked("graph-cut"), combinations(reach=(2.0,), weight=(2.0,), **IMPLIED)
        ),
        "total variation": Method(
            clicked("threshold"),
            combinations(reach=(4.0,), tv=(0.15, 0.5, 1.0), spreads=(2.5, 4.0)),
        ),
    },
}


def by_flow(
    crop: Crop, click: PersonClick, start: str, flow: str, settings: Settings
) -> tuple[Mask, int, str]:
    """Labels of a run of the program, its steps, and why it ended.

    The energy is that of Chan and Vese. ``area``: weight for noise as strong as the contrast, in voxels and contrasts
    squared; it grows with the noise, and is half of it up to half of that noise. By the program unless given.
    """
    x, y, z = click.centre
    given: dict[str, Any] = {
        "start" if start == BALL else "inside": f"ball:{x!r},{y!r},{z!r},{click.radius!r}"
    }
    h, sigma = min(crop.spacing), settings.get("presmooth", 0)
    if start == BALL:
        contrast = abs(crop.contrast) / scale_of(smoothed(crop, sigma)).width
        weight = (
            settings.get("area", 0.0) * max(crop.noise / abs(crop.contrast), 0.5) * contrast**2 * h
        )
        given["energy"] = f"chan-vese:area={weight!r}" if weight else "chan-vese"
    config = RunConfig(
        flow=FLOWS[flow], presmooth=sigma * h, max_steps=MAX_STEPS, threads=1, **given
    )
    result = segment(crop.image, config=config)
    return np.asarray(result.labels > 0), result.stop.steps, result.stop.reason


def ball_of(crop: Crop, start: str) -> PersonClick:
    """The click of `benchmarks.clicks`; to start from, half as wide again where that is in the object."""
    click = next_click(crop.truth, None, crop.image.geometry)
    assert click is not None  # an object has voxels
    wide = click._replace(radius=1.5 * click.radius)
    box, ball = ball_voxels(wide, crop.image.geometry)
    return wide if start == BALL and crop.truth[box][ball].all() else click


def measured(crop: Crop, start: str, name: str, settings: Settings) -> list[Any]:
    """Dice, mean surface distance (voxels), steps, seconds of a processor, and why it ended."""
    click, run = ball_of(crop, start), METHODS[start][name].run
    began = time.process_time()
    if run is not None:
        labels = run(crop, click, settings)
        steps = None
        reason = ""
    else:
        try:
            labels, steps, reason = by_flow(crop, click, start, name, settings)
        except AccelsurfError as error:
            labels = np.zeros(crop.truth.shape, np.bool_)
            steps = None
            reason = f"refused: {error}"
    seconds = time.process_time() - began
    far = surfaces(labels, crop.truth, crop.spacing)["mean_voxels"]
    return [
        round(dice(labels, crop.truth), 4),
        far and round(far, 3),
        steps,
        round(seconds, 3),
        reason,
    ]


# -- the study -----------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="of a processor; a later call goes on"
    )
    parser.add_argument(
        "--tables", action="store_true", help="only write the page again, from the JSON"
    )
    options = parser.parse_args()
    results: Results = (
        json.loads(RESULTS.read_text()) if RESULTS.exists() else {"scans": {}, "runs": {}}
    )
    if not options.tables:
        warm_up()
        for part, scan, start, name, settings in tasks(results):
            if time.process_time() > 60.0 * options.minutes:
                print("the time is up: call again to go on")
                break
            key = key_of(scan, part, start, name, settings)
            if key not in results["runs"]:
                crop = exposed(scan, part)
                place = results["scans"].setdefault(
                    scan,
                    {
                        "object": crop.name,
                        "shape": crop.values.shape,
                        "spacing": [round(h, 3) for h in crop.spacing],
                        "voxels": int(crop.truth.sum()),
                        "noise": {},
                    },
                )
                place["noise"][str(part)] = round(crop.noise / abs(crop.contrast), 3)
                results["runs"][key] = measured(crop, start, name, settings)
                print(key, results["runs"][key], flush=True)
                save(results)
    write(results)


def warm_up() -> None:
    """Load the compiled code, so that no run pays for it."""
    image = Volume.from_array(np.pad(np.ones((6, 6, 6), np.float32), 4), 1.0)
    for flow in FLOWS.values():
        segment(image, config=RunConfig(start=("ball:6,6,6,2",), flow=flow, threads=1))
    segment(image, inside="ball:6,6,6,2", threads=1)


def tasks(results: Results) -> Iterator[tuple[int, str, str, str, dict[str, Any]]]:
    """All runs in order: of an exposure those that settings are selected by, then those reported; slow ones last."""
    for slow, (part, at), is_tuned in itertools.product(
        (False, True), SELECTED_AT.items(), (True, False)
    ):
        for scan, start in itertools.product(scans(is_tuned), METHODS):
            for name, method in METHODS[start].items():
                if (name == SLOW) != slow or (is_tuned and (part != at or len(method.grid) == 1)):
                    continue
                settings = method.grid if is_tuned else [best(results, at, start, name)]
                settings = (
                    settings
                    if is_tuned or name not in FLOWS
                    else [*settings, best(results, at, start, MOMENTUM)]
                )
                yield from ((part, scan, start, name, each) for each in settings)


def key_of(scan: str, part: int, start: str, name: str, settings: Settings) -> str:
    """Name of a run in the JSON."""
    return f"{scan}/{part}/{start}/{name}/{','.join(f'{k}={v}' for k, v in settings.items())}"


def best(results: Results, part: int, start: str, name: str) -> dict[str, Any]:
    """The settings of a method with the best mean Dice on the half that they are selected on."""

    def score(settings: dict[str, Any]) -> float:
        return sum(
            results["runs"][key_of(scan, part, start, name, settings)][0] for scan in scans(True)
        )

    grid = METHODS[start][name].grid
    return max(grid, key=score) if len(grid) > 1 else grid[0]


@lru_cache(maxsize=1)
def exposed(scan: str, part: int) -> Crop:
    """A scan's crop at an exposure."""
    return degraded(crop_of(scan), scan, part)


def save(results: Results) -> None:
    """Write the JSON, a run a line."""
    lines = (f"{json.dumps(key)}: {json.dumps(row)}" for key, row in results["runs"].items())
    RESULTS.write_text(
        f'{{"scans": {json.dumps(results["scans"])}, "runs": {{\n' + ",\n".join(lines) + "\n}}\n"
    )


# -- the page ------------------------------------------------------------------------------------------------


class Reported(NamedTuple):
    """A run of the half that is reported."""

    dice: float
    far: float | None
    steps: int | None
    seconds: float
    stop: str


def compared(
    results: Results, part: int, start: str, settings_of: str = ""
) -> dict[str, dict[str, Reported]]:
    """For each scan that is reported the runs at an exposure, by method: of those that have been run on all.

    Each has its own settings, or those that another method has, where it has been run with them.
    """
    found = {}
    for scan in scans(False):
        runs = {}
        for name in METHODS[start]:
            selected_by = settings_of or name
            if all(
                key_of(each, SELECTED_AT[part], start, selected_by, settings) in results["runs"]
                for each in scans(True)
                for settings in METHODS[start][selected_by].grid[1:]
            ):
                key = key_of(
                    scan, part, start, name, best(results, SELECTED_AT[part], start, selected_by)
                )
                runs |= {name: Reported(*results["runs"][key])} if key in results["runs"] else {}
        if {MOMENTUM, DESCENT} <= set(runs):
            found[scan] = runs
    everywhere = set(METHODS[start]).intersection(*found.values())
    return {
        scan: {name: runs[name] for name in METHODS[start] if name in everywhere}
        for scan, runs in found.items()
    }


def reported(
    results: Results, part: int, start: str, name: str, settings_of: str = ""
) -> list[Reported]:
    """The runs of a method at an exposure; none where it has not been run on all scans on which momentum has."""
    return [
        runs[name] for runs in compared(results, part, start, settings_of).values() if name in runs
    ]


def write(results: Results) -> None:
    """Write tables and picture of what has been run."""
    put_table(PAGE, "scans", "\n".join(table_of_scans(results)), COMMAND)
    for start in METHODS:
        put_table(PAGE, f"from a {start}", "\n".join(table_of_methods(results, start)), COMMAND)
        put_table(
            PAGE,
            f"against momentum, from a {start}",
            "\n".join(table_of_pairs(results, start)),
            COMMAND,
        )
    put_table(PAGE, "settings", "\n".join(table_of_settings(results)), COMMAND)
    draw(results)


def label_of(part: int) -> str:
    """An exposure, as a reader has it."""
    return "as it is" if part == 1 else f"1/{part}"


def table_of_scans(results: Results) -> list[str]:
    """A row for each scan: its object, crop, and noise."""
    columns = (
        "scan",
        "object",
        "half",
        "crop",
        "spacing, mm",
        "voxels",
        *(f"noise, {label_of(p)}" for p in EXPOSURES),
    )
    lines = head_of(columns)
    for is_tuned in (True, False):
        for scan in (name for name in scans(is_tuned) if name in results["scans"]):
            place = results["scans"][scan]
            noise = (
                f"{place['noise'][str(p)]:.2f}" if str(p) in place["noise"] else ""
                for p in EXPOSURES
            )
            shapes = (
                " x ".join(f"{n:g}" for n in place[key][::-1]) for key in ("shape", "spacing")
            )
            half = "chosen on" if is_tuned else "reported"
            lines.append(
                row_of([scan, place["object"], half, *shapes, str(place["voxels"]), *noise])
            )
    return lines


def table_of_methods(results: Results, start: str) -> list[str]:
    """A row for each exposure and method."""
    lines = head_of(
        (
            "exposure",
            "method",
            "settings",
            "Dice",
            "distance",
            "steps",
            "seconds",
            "best",
            "no object",
        )
    )
    for part in EXPOSURES:
        winners = [
            max(runs, key=lambda name: runs[name].dice)
            for runs in compared(results, part, start).values()
        ]
        for name in METHODS[start]:
            runs = reported(results, part, start, name)
            if not runs:
                continue
            fars = [np.inf if run.far is None else run.far for run in runs]
            steps = [run.steps for run in runs if run.steps is not None]
            settings = said(best(results, SELECTED_AT[part], start, name))
            cells = [
                label_of(part),
                name,
                settings,
                f"{np.mean([run.dice for run in runs]):.3f}",
                f"{np.median(fars):.2f}",
                f"{np.median(steps):.0f}" if steps else "",
                f"{np.median([run.seconds for run in runs]):.2f}",
                f"{winners.count(name)} of {len(runs)}",
                str(sum(run.far is None for run in runs)),
            ]
            lines.append(row_of(cells))
    return lines


def table_of_pairs(results: Results, start: str) -> list[str]:
    """For each method and exposure by how much momentum is better, and how often."""
    lines = head_of(("momentum less", *(label_of(part) for part in EXPOSURES)))
    flows = [(name, MOMENTUM) for name in list(FLOWS)[1:] if start == BALL]
    for name, settings_of in [(name, "") for name in list(METHODS[start])[1:]] + flows:
        cells = [name + (", settings of momentum" if settings_of else "")]
        for part in EXPOSURES:
            others = reported(results, part, start, name, settings_of)
            mine = reported(results, part, start, MOMENTUM, settings_of) if others else []
            cells.append(compare(mine, others))
        lines.append(row_of(cells))
    return lines


def compare(mine: list[Reported], others: list[Reported]) -> str:
    """By how much the Dice of some runs is higher than that of others, how often, and the steps of the others."""
    if not mine:
        return ""
    gains = np.array([run.dice - other.dice for run, other in zip(mine, others, strict=True)])
    better, worse = int((gains > LEVEL).sum()), int((gains < -LEVEL).sum())
    steps = [
        other.steps / run.steps
        for run, other in zip(mine, others, strict=True)
        if other.steps and run.steps
    ]
    times = f", {np.median(steps):.1f} x its steps" if steps else ""
    return f"{gains.mean():+.3f} ({better} better, {gains.size - better - worse} level, {worse} worse){times}"


def table_of_settings(results: Results) -> list[str]:
    """For the flows from a ball each setting, on the half that settings are selected on."""
    lines = head_of(("exposure", "settings", *FLOWS, "momentum less descent"))
    for part, settings in itertools.product(sorted(set(SELECTED_AT.values())), FLOW_GRID):
        keys = {
            name: [key_of(scan, part, BALL, name, settings) for scan in scans(True)]
            for name in FLOWS
        }
        runs = {
            name: [Reported(*results["runs"][key]) for key in each]
            for name, each in keys.items()
            if all(key in results["runs"] for key in each)
        }
        dices = (
            f"{np.mean([run.dice for run in runs[name]]):.3f}" if name in runs else ""
            for name in FLOWS
        )
        if {MOMENTUM, DESCENT} <= set(runs):
            lines.append(
                row_of(
                    [label_of(part), said(settings), *dices, compare(runs[MOMENTUM], runs[DESCENT])]
                )
            )
    return lines


def said(settings: Settings) -> str:
    """Settings, as a reader has them."""
    return (
        " ".join(f"{key} {value:g}" for key, value in settings.items() if key not in FIXED)
        or "its own"
    )


def draw(results: Results) -> None:
    """Draw Dice against noise, and for each scan which method is best: momentum where it is level."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    colours = dict(zip(METHODS[BALL], COLOURS, strict=True))
    names, parts = (
        scans(False),
        [part for part in EXPOSURES if any(compared(results, part, start) for start in METHODS)],
    )
    figure, axes = plt.subplots(
        2, 2, sharex="col", figsize=(11, 8.5), dpi=100, layout="constrained"
    )
    for column, start in enumerate(METHODS):
        top, tiles = axes[0, column], axes[1, column]
        for name, settings_of in [*((name, "") for name in colours), (DESCENT, MOMENTUM)]:
            runs = [reported(results, part, start, name, settings_of) for part in parts]
            if not any(runs):
                continue
            means = [np.mean([run.dice for run in each] or [np.nan]) for each in runs]
            width, style = 2.5 if name == MOMENTUM else 1.2, ":" if settings_of else "-"
            label = f"{name}, settings of momentum" if settings_of else name
            top.plot(means, style, marker="o", color=colours[name], label=label, linewidth=width)
        top.set(title=f"from a {start}", ylabel="mean Dice", ylim=(0, 1))
        tiles.set_xticks(range(len(parts)), [label_of(part) for part in parts])
        for x, part in enumerate(parts):
            for scan, runs in compared(results, part, start).items():
                first = max(runs, key=lambda name: runs[name].dice)
                y, behind = names.index(scan), runs[first].dice - runs[MOMENTUM].dice
                words = f"{runs[first].dice:.2f}" + (f"  ({behind:.2f})" if behind > LEVEL else "")
                first = first if behind > LEVEL else MOMENTUM
                tiles.add_patch(
                    plt.Rectangle((x - 0.5, y - 0.5), 1, 1, color=colours[first], alpha=0.75)
                )
                tiles.text(x, y, words, ha="center", va="center", fontsize=8)
        tiles.set(xlim=(-0.5, len(parts) - 0.5), ylim=(len(names) - 0.5, -0.5), xlabel="exposure")
        tiles.set_yticks(range(len(names)), names, fontsize=8)
        tiles.set_title("best method and its Dice (how far momentum is behind)", fontsize=10)
    axes[0, 1].legend(frameon=False, fontsize=8, ncol=2)
    figure.savefig(PICTURE, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
