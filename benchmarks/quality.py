"""Whether results know how good they are: calibrates the probability of a good result, and shows how far it tells.

Results are the objects that the model of clicks shows after each of a simulated person's first clicks: an exact game
and a jittered one of each object of the clicks benchmark, and games in drawn scenes. A fold's results are judged by a
model made without it; the model of the program is made of all. Rows are kept in benchmarks/results/quality.json and
made again where the clicks' model, its code or its weights, is another, or with --again. One call writes them, the
models into accelsurf/measure/good_result.json, and the page's figure and tables.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import model as clicks_model
from accelsurf.clicks.model import click_model
from accelsurf.clicks.model.confidence import confidence_of
from accelsurf.evolution.records import Stop
from accelsurf.grid.boxes import whole_box
from accelsurf.image.volume import Volume
from accelsurf.measure import likely, quality
from accelsurf.measure.metrics import dice
from accelsurf.run.preprocessing import apply_filters, scale_of
from benchmarks.clicks.folds import FOLDS, PHANTOMS
from benchmarks.clicks.games import BASE, FAILED, GOOD, SAID, Hints
from benchmarks.clicks.objects import Scene, load, selected
from benchmarks.clicks.own import StartAlone
from benchmarks.clicks.person import PersonClick, next_click, voxels_of
from benchmarks.clicks.reading.scenes import scene as drawn_scene
from benchmarks.clicks.references import within
from benchmarks.pages import head_of, put_table, row_of

ROOT = Path(__file__).resolve().parent.parent
RESULTS_FILE = ROOT / "benchmarks" / "results" / "quality.json"
MODEL = ROOT / "accelsurf" / "measure" / likely.MODEL_FILE
PAGE, PICTURE = (
    ROOT / "docs" / "explanation" / "quality.md",
    ROOT / "docs" / "images" / "quality-reliability.png",
)
#: Clicks of a game; games of each object: None for exact clicks, a seed for jittered ones.
CLICKS, GAMES = 5, (None, 0)
#: Scenes that are drawn, other ones than the networks are trained on; objects of each, and what an object of them
#: counts beside one of a scan.
SCENES, OF_SCENE, SCENE_WEIGHT = range(900_000, 900_040), 2, 0.25
DRAWN = "scenes"
#: Which way each feature may count.
SIGNS = {
    "level_overlap": 1.0,
    "size_spread": -1.0,
    "correction": -1.0,
    "unchanged": 1.0,
    "surprise": -1.0,
    "rim": -1.0,
    "drift": -1.0,
    "no_edge": -1.0,
    "said": 1.0,
}
#: The models: by the clicks' model and the image, and by the image alone.
KINDS: tuple[likely.ModelKind, ...] = ("clicks", "image")
#: A warning is given below this probability: the result is probably not good.
WARNED = 0.5
#: Weight of the squares of the weights; a figure's point has at least so many results.
RIDGE, MANY = 3.0, 10
Row = dict[str, Any]
Rows = Mapping[str, Sequence[Mapping[str, Any]]]
DONE = Stop("converged", 0, 0.0, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", default="", help="make these rows, separated by commas; the others are kept"
    )
    parser.add_argument("--again", action="store_true", help="make rows again that are kept")
    parser.add_argument(
        "--fit", action="store_true", help="make no rows: calibrate on those of the JSON"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    options = parser.parse_args()
    results = json.loads(RESULTS_FILE.read_text()) if RESULTS_FILE.exists() else {"games": {}}
    if not options.fit:
        gather(results, options)
    held = {name: entry["rows"] for name, entry in results["games"].items() if entry["rows"]}
    models: dict[str, dict[str, Any]] = {
        kind: {**trained(held, kind), "threshold": WARNED} for kind in KINDS
    }
    models["clicks"]["threshold_corrected"] = even_odds(held, models["clicks"])
    MODEL.write_text(json.dumps(models, indent=1) + "\n")
    likely.calibrated_models.cache_clear()
    results["figures"] = {kind: every_figure(held, judged(held, kind)) for kind in KINDS}
    RESULTS_FILE.write_text(json.dumps(results, indent=0) + "\n")
    put_table(PAGE, "quality", text_of(results["figures"]))
    picture(results["figures"]["clicks"])
    print(text_of(results["figures"]))


# -- results ------------------------------------------------------------------------------------------------


def gather(results: dict[str, Any], options: argparse.Namespace) -> None:
    """Make the rows that are missing, or of another model, and write them as they come."""
    made_by = model_digest()
    only = {name for name in options.only.split(",") if name}
    began = time.monotonic()
    names = [which.name for which in selected()] if "ACCELSURF_VOLUMES" in os.environ else []
    if not names:
        print("ACCELSURF_VOLUMES is not set: phantoms and scenes only", file=sys.stderr)
        names = [which.name for which in selected([PHANTOMS])]
    names += [f"{DRAWN}-{seed}" for seed in SCENES]
    kept = {} if options.again else results["games"]
    missing = [
        name
        for name in names
        if (name in only if only else True) and kept.get(name, {}).get("made_by") != made_by
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        for name, rows in zip(missing, pool.map(rows_of, missing), strict=True):
            results["games"][name] = {"made_by": made_by, "rows": rows}
            RESULTS_FILE.write_text(json.dumps(results, indent=0) + "\n")
            print(
                f"{time.monotonic() - began:.0f} s {name}",
                [round(row["dice"], 2) for row in rows],
                flush=True,
            )


def model_digest() -> str:
    """What the model of the clicks is: its code and weights."""
    digest = hashlib.sha256()
    for file in sorted(Path(clicks_model.__file__).parent.glob("*.*")):
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def rows_of(name: str) -> list[Row]:
    """The rows of an object of the benchmark, or of a drawn scene."""
    if not name.startswith(DRAWN):
        (which,) = selected(names=[name])
        scan = load(which, Path(os.environ.get("ACCELSURF_VOLUMES", "")))
        return [{**row, "fold": which.fold} for seed in GAMES for row in in_game(scan, seed)]
    image, objects = drawn_scene(int(name.split("-")[1]))
    return [
        {**row, "fold": DRAWN}
        for number, truth in enumerate(objects[:OF_SCENE])
        for row in in_game(Scene(image, truth), GAMES[number % len(GAMES)])
    ]


def in_game(scene: Scene, seed: int | None) -> Iterator[Row]:
    """Results after each of the person's first clicks."""
    image, truth = scene.image, scene.truth
    values = image.as_float32()
    player = StartAlone(image.with_array(apply_filters(values, scale_of(values))), Hints())
    clicked = np.zeros(truth.shape, np.bool_)
    labels = None
    before = None
    for number in range(CLICKS):
        random = None if seed is None else np.random.default_rng([BASE, seed, number])
        click = next_click(truth, labels, image.geometry, random)
        if click is None:
            break
        found = player.click(click)
        voxels = voxels_of(click, image.geometry)
        clicked[voxels.box] |= voxels.mask
        labels = within(found, scene.region)
        if before is not None and before["hinted"] is not None:
            before["person"] = dice(labels, truth)
        if before is not None:
            yield before
        before = row_of_result(player, found, clicked, scene)
        before["game"] = "exact" if seed is None else "jittered"
    if before is not None:
        yield before


def row_of_result(
    player: StartAlone, found: NDArray[np.bool_], clicked: NDArray[np.bool_], scene: Scene
) -> Row:
    """The features of a result, its Dice, and that after a click at the place that is proposed."""
    assert player.model is not None
    seen, geometry = player.scene.images[0], scene.image.geometry
    measured = quality.measured(
        quality.Judged(
            found.astype(np.uint8),
            seen,
            geometry,
            [],
            DONE,
            clicked=clicked,
            confidence=confidence_of(player.model),
        )
    )
    features = likely.click_features(measured)
    assert features is not None
    value = dice(within(found, scene.region), scene.truth)
    hinted = None
    if value < GOOD and measured.next_click is not None:
        z, y, x = (int(i) for i in np.rint(geometry.world_to_index(measured.next_click)))
        side = "inside" if scene.truth[z, y, x] else "outside"
        point = PersonClick(side, (z, y, x), measured.next_click, 0.5 * min(geometry.spacing))
        clicks = player.clicks.with_more([voxels_of(point, scene.image.geometry)])
        after = click_model(player.scene, clicks, previous=player.model).inside_on(
            whole_box(geometry.shape)
        )
        hinted = dice(within(after, scene.region), scene.truth)
    return {
        "dice": round(value, 4),
        "clicks": _rounded({**features, **likely.history_features(measured)}),
        "image": _rounded(likely.image_features(measured)),
        "hinted": hinted,
        "person": None,
    }


def _rounded(features: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in features.items()}


# -- the model ----------------------------------------------------------------------------------------------


def trained(rows: Rows, kind: str) -> dict[str, Any]:
    """A logistic model with a ridge, by Newton's method; each object counts the same, one of a scene less.

    Measures of the corrections are held fast while the others are fitted, and then count as those of a result that
    nobody has corrected: the person of the games clicks where most is wrong, another one anywhere.

    Its means, deviations and weights by feature, and its constant.
    """
    every = [(row, _weight(row) / len(each)) for each in rows.values() for row in each]
    names = sorted(SIGNS.keys() & every[0][0][kind].keys())
    table = np.array([[row[kind][name] for name in names] for row, _ in every])
    weight = np.array([w for _, w in every])
    weight *= len(every) / weight.sum()
    target = np.array([float(row["dice"] >= GOOD) for row, _ in every])
    mean = np.average(table, axis=0, weights=weight)
    deviation = np.maximum(np.sqrt(np.average((table - mean) ** 2, axis=0, weights=weight)), 1e-6)
    x = np.column_stack([np.ones(len(every)), (table - mean) / deviation])
    ridge, signs = (
        np.diag([0.0] + [RIDGE] * len(names)),
        np.array([0.0] + [SIGNS[name] for name in names]),
    )
    beta = _solved(x, weight, target, ridge)
    # A measure that would count the wrong way tells of these objects, not of objects.
    while (wrong := (beta * signs < 0)).any():
        x[:, wrong] = 0.0
        beta = _solved(x, weight, target, ridge)
    listed = {
        name: [round(float(v), 6) for v in (mean[i], deviation[i], beta[i + 1])]
        for i, name in enumerate(names)
    }
    usual, constant = _usual(), float(beta[0])
    for name in usual.keys() & listed.keys():
        average, spread, weight_of = listed.pop(name)
        constant += weight_of * (usual[name] - average) / spread
    return {"features": listed, "constant": round(constant, 6)}


def even_odds(rows: Rows, model: Mapping[str, Any]) -> float:
    """The stated probability at which half of the corrected results are good.

    The model counts no measure of a correction, so it states less than is true of results that a person has corrected.
    """
    values_of = {
        name: [
            value
            for row, value in zip(each, stated(model, each, "clicks"), strict=True)
            if is_corrected(row)
        ]
        for name, each in rows.items()
    }
    corrected = {
        name: [
            {**row, "clicks": {"said": float(np.log(value / (1.0 - value)))}}
            for row, value in zip(
                (row for row in rows[name] if is_corrected(row)), values, strict=True
            )
        ]
        for name, values in values_of.items()
        if values
    }
    line = trained(corrected, "clicks")
    mean, deviation, weight = line["features"]["said"]
    even = mean - line["constant"] * deviation / weight
    return round(float(1.0 / (1.0 + np.exp(-even))), 4)


def is_corrected(row: Mapping[str, Any]) -> bool:
    """True of a result that a click has corrected."""
    usual = _rounded(_usual())
    return any(row["clicks"].get(name, value) != value for name, value in usual.items())


@functools.cache
def _usual() -> dict[str, float]:
    """Measures of the corrections of a result that nobody has corrected."""
    shown = np.zeros((3, 3, 3), np.uint8)
    geometry = Volume.from_array(np.zeros((3, 3, 3), np.float32), 1.0).geometry
    nothing = quality.measured(
        quality.Judged(shown, np.zeros((3, 3, 3), np.float32), geometry, [], DONE)
    )
    return likely.history_features(nothing)


def _weight(row: Mapping[str, Any]) -> float:
    return SCENE_WEIGHT if row.get("fold") == DRAWN else 1.0


def _solved(
    x: NDArray[Any], weight: NDArray[Any], target: NDArray[Any], ridge: NDArray[Any]
) -> NDArray[Any]:
    """The weights of a logistic model with a ridge."""
    beta = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ beta, -50, 50)))
        hessian = x.T @ (x * (weight * p * (1.0 - p))[:, None]) + ridge + 1e-9 * np.eye(len(beta))
        beta = beta + np.linalg.solve(hessian, x.T @ (weight * (target - p)) - ridge @ beta)
    return np.asarray(beta)


def probabilities(
    model: Mapping[str, Any], rows: Iterable[Mapping[str, Any]], kind: str
) -> list[float]:
    """The probability of a good result of each row."""
    out = []
    for row in rows:
        total = model["constant"] + sum(
            weight * (row[kind][name] - mean) / deviation
            for name, (mean, deviation, weight) in model["features"].items()
        )
        out.append(float(1.0 / (1.0 + np.exp(-np.clip(total, -50, 50)))))
    return out


def stated(model: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], kind: str) -> list[float]:
    """The probabilities as the program states them: in a game no click raises that of the result before it."""
    out: list[float] = []
    game = None
    for row, value in zip(rows, probabilities(model, rows, kind), strict=True):
        is_first = not out or row.get("game") != game
        out.append(value if is_first else min(value, out[-1]))
        game = row.get("game")
    return out


class Judged(NamedTuple):
    """The probabilities of the rows of an object, and below which of them a warning is given."""

    probabilities: list[float]
    thresholds: list[float]


def judged(rows: Rows, kind: str) -> dict[str, Judged]:
    """Judge the rows by models that were made without their fold."""
    folds = {name: str(each[0]["fold"]) for name, each in rows.items()}
    out: dict[str, Judged] = {}
    for fold in sorted(set(folds.values())):
        others = {name: each for name, each in rows.items() if folds[name] != fold}
        model = trained(others, kind)
        even = even_odds(others, model) if kind == "clicks" else WARNED
        out |= {
            name: Judged(
                (stated if kind == "clicks" else probabilities)(model, each, kind),
                [even if is_corrected(row) else WARNED for row in each],
            )
            for name, each in rows.items()
            if folds[name] == fold
        }
    return out


def table_of(
    rows: Rows, said: Mapping[str, Judged]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities, Dice and weights of all rows."""
    p = [value for name in rows for value in said[name].probabilities]
    d = [row["dice"] for each in rows.values() for row in each]
    w = [_weight(row) / len(each) for each in rows.values() for row in each]
    return np.array(p), np.array(d), np.array(w)


# -- figures and the page -----------------------------------------------------------------------------------


def every_figure(rows: Rows, said: Mapping[str, Judged]) -> dict[str, Any]:
    """The figures of all scans, of each fold, of the phantoms and of the drawn scenes."""
    fold_of = {name: str(each[0]["fold"]) for name, each in rows.items()}
    parts = {
        "all scans": {fold.name for fold in FOLDS},
        **{f"fold {fold.name}": {fold.name} for fold in FOLDS},
        PHANTOMS: {PHANTOMS},
        DRAWN: {DRAWN},
    }
    out = {}
    for part, folds in parts.items():
        here = {name: each for name, each in rows.items() if fold_of[name] in folds}
        if here:
            out[part] = figures(here, said)
    return out


def figures(rows: Rows, said: Mapping[str, Judged]) -> dict[str, Any]:
    """What of the results said to be good is, what of the failures is said to be, the curve, and what a hint does."""
    p, d, _ = table_of(rows, said)
    says, failed = p >= SAID, d < FAILED
    warned = p < np.array([value for name in rows for value in said[name].thresholds])
    curve = []
    for low in np.arange(0.0, 1.0, 0.2):
        here = (p >= low) & ((p < low + 0.2) | (low > 0.75))
        if here.any():
            curve.append(
                {
                    "stated": float(p[here].mean()),
                    "good": float((d[here] >= GOOD).mean()),
                    "results": int(here.sum()),
                }
            )
    doubted = [
        row
        for name, each in rows.items()
        for row, value, least in zip(each, *said[name], strict=True)
        if value < least and row["hinted"] is not None and row["person"] is not None
    ]
    gains = {
        key: np.array([row[key] - row["dice"] for row in doubted]) for key in ("hinted", "person")
    }
    return {
        "objects": len(rows),
        "results": len(p),
        "good": float((d >= GOOD).mean()),
        "said": int(says.sum()),
        "good_of_said": float((d[says] >= GOOD).mean()) if says.any() else None,
        "failed": int(failed.sum()),
        "said_of_failed": float(says[failed].mean()) if failed.any() else None,
        "doubted_of_good": float(warned[d >= GOOD].mean()) if (d >= GOOD).any() else None,
        "doubted_of_failed": float(warned[failed].mean()) if failed.any() else None,
        "curve": curve,
        "hints": len(doubted),
        **{
            f"{key}_{what}": float(value) if len(doubted) else None
            for key, gain in gains.items()
            for what, value in (
                ("raises", np.mean(gain > 0.005) if len(doubted) else 0.0),
                ("gain", np.mean(gain) if len(doubted) else 0.0),
            )
        },
    }


def text_of(figures: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """The page's tables."""
    found = figures["clicks"]
    lines = head_of(
        (
            "results of",
            "results",
            f"good (Dice {GOOD})",
            f"said to be good ({SAID:.0%})",
            "of these good",
            f"failed (below {FAILED})",
            "of these said to be good",
            "of these with a warning",
            "good ones with a warning",
        )
    )
    alone = {
        f"{part}, by the image alone": own
        for part, own in figures["image"].items()
        if part == "all scans"
    }
    for part, own in (*found.items(), *alone.items()):
        keys = ("good_of_said", "said_of_failed", "doubted_of_failed", "doubted_of_good")
        of_said, *rest = ("-" if own[key] is None else f"{own[key]:.0%}" for key in keys)
        cells = (
            part,
            str(own["results"]),
            f"{own['good']:.0%}",
            str(own["said"]),
            of_said,
            str(own["failed"]),
        )
        lines.append(row_of((*cells, *rest)))
    lines += [
        "",
        *head_of(
            (
                "results with a warning",
                "number",
                "a click at the doubtful place raises the Dice",
                "by",
                "the person's own click raises it",
                "by",
            )
        ),
    ]
    for part, own in found.items():
        if own["hints"] and not part.startswith("fold"):
            told = [
                f"{own[f'{key}_raises']:.0%} {own[f'{key}_gain']:+.3f}"
                for key in ("hinted", "person")
            ]
            lines.append(row_of((part, str(own["hints"]), *" ".join(told).split())))
    return "\n".join(lines) + "\n"


def picture(found: Mapping[str, Mapping[str, Any]]) -> None:
    """The reliability curve of each fold."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(4.6, 5.0), dpi=120)
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for part, own in found.items():
        many = [point for point in own["curve"] if point["results"] >= MANY]
        stated, good = ([point[key] for point in many] for key in ("stated", "good"))
        style = {"color": "black", "linewidth": 2.5} if part == "all scans" else {"linewidth": 1}
        axes.plot(
            stated, good, marker="o", markersize=4, label=f"{part} ({own['results']})", **style
        )
    axes.set(
        xlabel="stated probability",
        ylabel=f"share with a Dice of {GOOD} or more",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncol=3, fontsize=7)
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
