"""Whether results know how good they are: calibrates the probability of a good result, and shows how reliable it is.

Results are made on phantoms (several energies, noises and starts) and on the objects of the clicks benchmark, by the
simulated person's first clicks: an exact game and a jittered one of each object, ``accelsurf segment`` at the first
click and ``accelsurf refine`` at each later one. By default only those to tune on; ``--half report`` measures the other
half with the models as they are, and calibrates nothing. One call writes the features of each result and its Dice into
benchmarks/results/quality.json, the models into accelsurf/measure/good_result.json, and the page's figure and table.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import accelsurf
from accelsurf.errors import AccelsurfError
from accelsurf.image.volume import Volume
from accelsurf.measure import quality
from accelsurf.measure.metrics import dice
from accelsurf.measure.quality import click_features, image_features
from accelsurf.phantoms import recipes
from benchmarks.clicks.games import Hints
from benchmarks.clicks.objects import chosen, load
from benchmarks.clicks.own import Refined
from benchmarks.clicks.person import next_click
from benchmarks.pages import head_of, put_table, row_of

ROOT = Path(__file__).resolve().parent.parent
FACTS, MODEL = ROOT / "benchmarks" / "results" / "quality.json", ROOT / "accelsurf" / "analysis" / quality.MODEL_FILE
PAGE, PICTURE = ROOT / "docs" / "explanation" / "quality.md", ROOT / "docs" / "images" / "quality-reliability.png"
#: Objects that the model is calibrated on, and those that it is reported on.
HALVES = {
    "tune": (
        "spleen", "stomach", "vertebra-T11", "vena-cava", "cord-ct", "nucleus-17", "nucleus-19", "nucleus-27",
        "ventricle-left", "thalamus-left", "putamen-left", "third-ventricle", "brain-stem", "cerebellum-right",
        "caudate-right", "pallidum-right", "cord",
    ),
    "report": (
        "liver", "vertebra-T12", "aorta", "humerus-left", "back-muscle-left", "nucleus-18", "nucleus-26", "nucleus-28",
        "cerebellum-left", "caudate-left", "pallidum-left", "fourth-ventricle", "ventricle-right", "thalamus-right",
        "putamen-right", "white-matter",
    ),
}
#: A result is good from this Dice on. Silent failures are below the second without a warning, false alarms are above
#: the third with one.
GOOD, FAILED, FINE = 0.8, 0.7, 0.85
#: Clicks of each game, and the games of each object: None for exact clicks, a seed for jittered ones.
CLICKS, GAMES = 5, (None, 0)
#: Phantoms, noise in parts of the contrast, and energies.
PHANTOMS = ("ball", "ball_anisotropic", "ball_small", "box", "cube", "disc", "torus", "two_balls")
NOISE = (0.3, 1.0)
ENERGIES: tuple[dict[str, Any], ...] = (
    {}, {"energy": "threshold:learned,learned", "smoothness": 0.5}, {"energy": "local-region"},
    {"presmooth": "1vox", "smoothness": 0.3}, {"energy": "threshold:learned,learned", "presmooth": "1vox"},
)
#: Which way each feature may count.
SIGNS = {
    "contrast": 1.0, "evidence": 1.0, "beyond_clicks": 1.0, "compactness": 1.0, "clicked": -1.0, "inside_like": -1.0,
    "drift": -1.0, "border": -1.0, "burst": -1.0, "growth": -1.0, "no_edge": -1.0, "unconverged": -1.0,
    "level_overlap": 1.0, "corrections": 1.0, "correction": -1.0, "size_spread": -1.0,
}
#: The models. Rows with clicks make the first one and are judged by it; all rows make the other, which judges the rest.
KINDS: tuple[quality.ModelKind, ...] = ("clicks", "image")
#: The figure has points of at least so many results.
MANY = 5
#: Weight of the squares of the weights, and folds of the cross-validation: whole objects are left out.
RIDGE, FOLDS = 0.5, 17


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=HALVES, default="tune")
    parser.add_argument("--only", default="", help="objects and phantoms, separated by commas; the others are kept")
    parser.add_argument("--fit", action="store_true", help="no runs: calibrate on the rows of the JSON")
    parser.add_argument("--kind", choices=KINDS, default="clicks", help="the model that is calibrated")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no object after so many")
    options = parser.parse_args()
    folder = os.environ.get("ACCELSURF_VOLUMES")
    facts = json.loads(FACTS.read_text()) if FACTS.exists() else {"rows": {half: {} for half in HALVES}}
    rows: dict[str, dict[str, list[dict[str, Any]]]] = facts["rows"]
    began, only = time.monotonic(), {name for name in options.only.split(",") if name}
    for name, found in () if options.fit else results(options.half, folder, only):
        rows[options.half][name] = found
        FACTS.write_text(json.dumps(facts, indent=0) + "\n")
        print(name, [round(row["dice"], 2) for row in found], flush=True)
        if time.monotonic() - began > 60.0 * options.minutes:
            print("the time is over", file=sys.stderr)
            break
    if options.half == "tune":
        models = json.loads(MODEL.read_text())
        models[options.kind] = fit(rows_of(rows["tune"], options.kind), options.kind)
        MODEL.write_text(json.dumps(models, indent=1) + "\n")
        quality.calibrated_models.cache_clear()
    facts["figures"] = every_figure(rows)
    FACTS.write_text(json.dumps(facts, indent=0) + "\n")
    put_table(PAGE, "quality", text_of(facts["figures"]))
    picture(facts["figures"])
    print(json.dumps(facts["figures"], indent=1))


# -- results ------------------------------------------------------------------------------------------------


def results(half: str, folder: str | None, only: set[str]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """The rows of each phantom (for the tuning half) and of each object."""
    for name in PHANTOMS if half == "tune" else ():
        if not only or name in only:
            yield name, list(on_phantom(name))
    if folder is None:
        print("ACCELSURF_VOLUMES is not set: phantoms only", file=sys.stderr)
        return
    for one in chosen(names=HALVES[half]):
        if not only or one.name in only:
            scene = load(one, Path(folder))
            yield one.name, list(by_clicks(scene.image, scene.truth))


def on_phantom(name: str) -> Iterator[dict[str, Any]]:
    """Runs on a phantom from the person's first click; a second object of the same brightness beside it makes leaks."""
    recipe = recipes.load_recipe(name)
    for noise in NOISE:
        made = recipes.make(recipe.changed(noise=noise * abs(recipe.contrast)))
        truth = np.asarray(made.truth.array > 0)
        for part in (truth, *halves(truth)):
            click = next_click(part, None, made.image.geometry)
            assert click is not None
            for settings in ENERGIES:
                start = "ball:" + ",".join(map(repr, (*click.centre, click.radius)))
                yield from measured(made.image, part, {"start": start, "max_steps": 200, **settings})


def halves(truth: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """One side of an object as if it were the object: what is found beyond is a leak into the same brightness."""
    half = truth.copy()
    half[:, :, truth.shape[2] // 2 :] = False
    return [half] if half.any() else []


def by_clicks(image: Volume, truth: NDArray[np.bool_]) -> Iterator[dict[str, Any]]:
    """Results after each of the person's first clicks, game after game."""
    for seed in GAMES:
        random = None if seed is None else np.random.default_rng(seed)
        player, labels = Refined(image, Hints()), None
        for _ in range(CLICKS):
            click = next_click(truth, labels, image.geometry, random)
            if click is None:
                break
            try:
                labels = player.click(click)
            except AccelsurfError:
                break
            found = row_from(player.result, truth, image)
            if found is None:
                break
            yield {"game": "exact" if seed is None else "jittered", **found}


def measured(image: Volume, truth: NDArray[np.bool_], options: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The row of a run; none where it failed."""
    try:
        found = row_from(accelsurf.segment(image, threads=1, **options), truth, image)
    except AccelsurfError:
        return
    if found is not None:
        yield found


def row_from(result: accelsurf.Result, truth: NDArray[np.bool_], image: Volume) -> dict[str, Any] | None:
    """The features of a result, its Dice, and how far the doubtful place lies from what is wrong; None of nothing."""
    labels, quality = np.asarray(result.labels > 0), result.quality
    if not result.objects[0].has_surface or quality is None:
        return None
    said = click_features(quality)
    return {
        "dice": dice(labels, truth), "image": image_features(quality, result.stop.reason, result.volume_mm3),
        **({} if said is None else {"clicks": said}),
        "other_warnings": [text.split(":")[0] for text in quality.warnings if not text.startswith("doubt")],
        **doubtful(quality.next_click, labels, truth, image),
    }


def doubtful(
    place: tuple[float, float, float] | None, labels: NDArray[np.bool_], truth: NDArray[np.bool_], image: Volume
) -> dict[str, Any]:
    """Whether a wrong voxel lies beside the doubtful place, for what share of the surface one does, and how near the
    place is to the person's next click.
    """
    wrong = labels != truth
    following = next_click(truth, labels, image.geometry)
    if place is None or following is None or not wrong.any():
        return {"at_wrong": None, "to_click": None, "chance_wrong": None, "closer": None}
    spacing = np.array(image.geometry.spacing)
    away = ndimage.distance_transform_edt(~wrong, sampling=spacing)
    index = np.rint(image.geometry.world_to_index(place)).astype(int)
    rim = labels & ~ndimage.binary_erosion(labels, border_value=1)
    apart = np.linalg.norm(np.array(following.centre) - np.array(place))
    return {
        "at_wrong": float(away[tuple(index)] <= 1.01 * max(spacing)), "to_click": float(apart),
        "chance_wrong": float((away[rim] <= 1.01 * max(spacing)).mean()),
        # Share of the surface that lies farther from the person's next click: 0.5 is chance.
        "closer": float((np.linalg.norm((np.argwhere(rim) - following.index) * spacing, axis=1) > apart).mean()),
    }


# -- the model ----------------------------------------------------------------------------------------------


Rows = Mapping[str, Sequence[Mapping[str, Any]]]


def rows_of(rows: Rows, kind: quality.ModelKind) -> Rows:
    """The rows that make a model: those with clicks, or all."""
    return rows if kind == "image" else {name: own for name, own in rows.items() if all(kind in row for row in own)}


def fit(rows: Rows, kind: quality.ModelKind) -> dict[str, Any]:
    """The logistic model of all rows; each object or phantom counts the same. Its threshold by cross-validation."""
    found = trained(rows, kind)
    values, truth, weights = [], [], []
    for name, own in rows.items():
        values += list(crossed(rows, name, kind))
        truth += [row["dice"] for row in own]
        weights += [1.0 / len(own) for _ in own]
    found["threshold"] = best_threshold(np.array(values), np.array(truth), np.array(weights))
    return found


def trained(rows: Rows, kind: quality.ModelKind) -> dict[str, Any]:
    """Means, deviations and weights of the features by Newton's method with a ridge."""
    every = [(row, 1.0 / len(own)) for own in rows.values() for row in own]
    names = sorted(every[0][0][kind])
    table = np.array([[row[kind][name] for name in names] for row, _ in every])
    weight = np.array([w for _, w in every])
    weight *= len(every) / weight.sum()
    target = np.array([float(row["dice"] >= GOOD) for row, _ in every])
    mean = np.average(table, axis=0, weights=weight)
    deviation = np.maximum(np.sqrt(np.average((table - mean) ** 2, axis=0, weights=weight)), 1e-6)
    x = np.column_stack([np.ones(len(every)), (table - mean) / deviation])
    ridge = np.diag([0.0] + [RIDGE] * len(names))
    beta = _solved(x, weight, target, ridge)
    signs = np.array([0.0] + [SIGNS[name] for name in names])
    # A measure that would count the wrong way tells of these objects, not of objects.
    while (wrong := (beta * signs < 0)).any():
        x[:, wrong] = 0.0
        beta = _solved(x, weight, target, ridge)
    listed = {
        name: [round(float(v), 6) for v in (mean[i], deviation[i], beta[i + 1])] for i, name in enumerate(names)
    }
    return {"features": listed, "constant": round(float(beta[0]), 6), "threshold": 0.5}


def _solved(x: NDArray[Any], weight: NDArray[Any], target: NDArray[Any], ridge: NDArray[Any]) -> NDArray[Any]:
    """The weights of a logistic model with a ridge, by Newton's method."""
    beta = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ beta, -50, 50)))
        hessian = x.T @ (x * (weight * p * (1.0 - p))[:, None]) + ridge + 1e-9 * np.eye(len(beta))
        beta = beta + np.linalg.solve(hessian, x.T @ (weight * (target - p)) - ridge @ beta)
    return np.asarray(beta)


def probabilities(
    model: Mapping[str, Any], own: Sequence[Mapping[str, Any]], kind: quality.ModelKind
) -> list[float]:
    """The probability of a good result of each row."""
    out = []
    for row in own:
        total = model["constant"] + sum(
            weight * (row[kind][name] - mean) / deviation
            for name, (mean, deviation, weight) in model["features"].items()
        )
        out.append(float(1.0 / (1.0 + np.exp(-np.clip(total, -50, 50)))))
    return out


def crossed(rows: Rows, name: str, kind: quality.ModelKind) -> list[float]:
    """The probabilities of an object's rows by a model that was made without the objects of its fold."""
    order = sorted(rows)
    fold = order.index(name) % FOLDS
    others = {key: own for i, key in enumerate(order) if i % FOLDS != fold for own in [rows[key]]}
    return probabilities(trained(others or rows, kind), rows[name], kind)


def best_threshold(values: NDArray[Any], truth: NDArray[Any], weights: NDArray[Any]) -> float:
    """The probability with the least larger one of the shares of silent failures and of false alarms."""
    def cost(limit: float) -> tuple[float, float]:
        silent, false = shares(values >= limit, truth, weights)
        return max(silent, false), silent + false

    return float(min(np.round(np.arange(0.05, 0.96, 0.01), 2), key=lambda limit: (*cost(limit), limit)))


def shares(quiet: NDArray[Any], truth: NDArray[Any], weights: NDArray[Any]) -> tuple[float, float]:
    """Of all results: the share of failures without a warning, and of good ones with one."""
    total = weights.sum()
    return (
        float(weights[quiet & (truth < FAILED)].sum() / total), float(weights[~quiet & (truth >= FINE)].sum() / total)
    )


def every_figure(rows: Mapping[str, Rows]) -> dict[str, Any]:
    """The figures of each half's exact and jittered games, and of the phantoms."""
    models = json.loads(MODEL.read_text())
    out = {}
    for half, own in rows.items():
        clicked = rows_of(own, "clicks")
        said = {
            name: crossed(clicked, name, "clicks") if half == "tune" else probabilities(models["clicks"], few, "clicks")
            for name, few in clicked.items()
        }
        # The model of the image may be older than the rows: they are judged by it as it is.
        said |= {name: probabilities(models["image"], own[name], "image") for name in own if name not in clicked}
        for game in ("exact clicks", "jittered clicks", "phantoms"):
            judged = {
                name: [pair for pair in zip(few, said[name], strict=True) if pair[0].get("game", "phantoms") in game]
                for name, few in own.items()
            }
            judged = {name: pairs for name, pairs in judged.items() if pairs}
            if judged:
                limit = models["image" if game == "phantoms" else "clicks"]["threshold"]
                out[f"{half}, {game}"] = figures(judged, limit)
    return out


def figures(judged: Mapping[str, Sequence[tuple[Mapping[str, Any], float]]], threshold: float) -> dict[str, Any]:
    """Silent failures, false alarms, the reliability curve, and how well the doubtful place finds what is wrong.

    ``judged`` has the rows of each object, each with its probability.
    """
    values: list[float] = []
    truth, weights, place = [], [], []
    for pairs in judged.values():
        values += [said for _, said in pairs]
        truth += [row["dice"] for row, _ in pairs]
        weights += [1.0 / len(pairs) for _ in pairs]
        place += [row for row, _ in pairs if row["at_wrong"] is not None and row["dice"] < FINE]
    p, d, w = np.array(values), np.array(truth), np.array(weights)
    silent, false = shares(p >= threshold, d, w)
    failed, fine = float(w[d < FAILED].sum()), float(w[d >= FINE].sum())
    curve = []
    for low in np.arange(0.0, 1.0, 0.2):
        here = (p >= low) & ((p < low + 0.2) | (low > 0.75))
        if here.any():
            good = float(np.average((d[here] >= GOOD).astype(float), weights=w[here]))
            stated = float(np.average(p[here], weights=w[here]))
            curve.append({"stated": stated, "good": good, "results": int(here.sum())})
    return {
        "results": len(p), "objects": len(judged), "silent": silent, "false": false,
        "silent_of_failures": silent * w.sum() / failed if failed else None,
        "false_of_good": false * w.sum() / fine if fine else None, "curve": curve,
        **{key: float(np.mean([row[key] for row in place])) if place else None
           for key in ("at_wrong", "chance_wrong", "closer")},
    }


# -- the page -----------------------------------------------------------------------------------------------


def text_of(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The page's table."""
    columns = ("results of", "number", "silent failures", "false alarms", "doubtful place is wrong", "a random one",
               "surface farther from the next click")
    lines = head_of(columns)
    for half, own in found.items():
        cells = [half, str(own["results"])]
        for key in ("silent", "false", "at_wrong", "chance_wrong", "closer"):
            cells.append("" if own[key] is None else f"{own[key]:.0%}")
        lines.append(row_of(cells))
    return "\n".join(lines) + "\n"


def picture(found: Mapping[str, Mapping[str, Any]]) -> None:
    """The reliability curve."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(4.6, 5.0), dpi=120)
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for half, own in found.items():
        many = [point for point in own["curve"] if point["results"] >= MANY]
        stated, good = ([point[key] for point in many] for key in ("stated", "good"))
        axes.plot(stated, good, marker="o", label=f"{half} ({own['results']} results)")
    axes.set(xlabel="stated probability", ylabel="share with a Dice of 0.8 or more", xlim=(0, 1), ylim=(0, 1))
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncol=2, fontsize=7)
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
