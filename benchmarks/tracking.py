"""Where momentum helps tracking: four models on phantoms in time, at four speeds, with noise and hidden frames.

Usage: python -m benchmarks.tracking [-o FILE] [--seeds N] [--quick]

Each sequence is followed by each model from the true surface of its first frame. What counts is the share of the later
frames in which the object is where it should be (Dice of 0.9 or more), and of the hidden frames apart. ``cost`` has the
seconds of a frame by each model over those of a restart from the last surface, each model in turn.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from accelsurf.image.volume import Volume
from accelsurf.phantoms.motions import MotionRecipe, MovingPhantom, motion_from
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track.records import FrameResult
from accelsurf.track.track import Tracking

ROOT = Path(__file__).parents[1]
MODELS = ("flowable-mass", "last-displacement", "none")
SPEEDS = (0.5, 1.0, 2.0, 4.0)
NOISE = (0.3, 1.0)
#: Hidden frames: none, or three in a row.
HIDDEN: tuple[tuple[int, ...], ...] = ((), (5, 6, 7))
MOTIONS = ("translation", "acceleration")
RADIUS, GOOD = 7.0, 0.9
FRAMES = 11


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/tracking.json"
    )
    options.add_argument(
        "--quick", action="store_true", help="one seed and two speeds, to see that it works"
    )
    options.add_argument("--seeds", type=int, default=3, help="sequences of each kind")
    given = options.parse_args()
    speeds, seeds = (SPEEDS[::2], (0,)) if given.quick else (SPEEDS, tuple(range(given.seeds)))
    cases = list(itertools.product(MOTIONS, speeds, NOISE, HIDDEN, seeds, MODELS))
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(followed, cases))
    turns = [
        {**row, "turning": True} for row in map(followed_turn, itertools.product(MODELS, seeds))
    ]
    found = {
        "rows": rows,
        "turning": turns,
        "summary": summary(rows),
        "cost": cost(1 if given.quick else 5),
    }
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(found, indent=1) + "\n")
    picture(rows, given.output.with_suffix(".png"))
    for line in found["summary"]:
        print(line)
    print(
        "turning",
        {
            model: round(statistics.mean(one["share"] for one in turns if one["model"] == model), 3)
            for model in MODELS
        },
    )
    print("cost", found["cost"])


def recipe_of(
    motion: str, speed: float, noise: float, hidden: tuple[int, ...], seed: int
) -> MotionRecipe:
    """A ball that crosses a grid which is as long as its way."""
    way = speed * RADIUS * (FRAMES - 1) / 10.0
    long = 2 * int(np.ceil(0.5 * way + RADIUS + 8))
    values = {
        "motion": motion,
        "shape": [long, 36, 36],
        "radius": RADIUS,
        "speed": speed,
        "frames": FRAMES,
    }
    return motion_from(
        {**values, "noise": noise, "empty": list(hidden), "seed": seed}, f"{motion}-{speed:g}"
    )


def followed(case: tuple[str, float, float, tuple[int, ...], int, str]) -> dict[str, Any]:
    """One sequence by one model."""
    motion, speed, noise, hidden, seed, model = case
    scores = dice_of_frames(recipe_of(motion, speed, noise, hidden, seed), model)
    shown = [score for number, score in scores.items() if number not in hidden]
    dark = [scores[number] for number in hidden]
    return {
        "motion": motion,
        "speed": speed,
        "noise": noise,
        "hidden": list(hidden),
        "seed": seed,
        "model": model,
        "dice": {str(number): round(score, 4) for number, score in scores.items()},
        "share": share(shown),
        "share_hidden": share(dark) if dark else None,
    }


def followed_turn(case: tuple[str, int]) -> dict[str, Any]:
    """An ellipsoid that turns by a quarter, hidden in two frames."""
    model, seed = case
    values = {
        "motion": "rotation",
        "shape": [40, 40, 32],
        "radius": 9.0,
        "speed": 0.25,
        "noise": 0.3,
    }
    scores = dice_of_frames(
        motion_from({**values, "empty": [5, 6], "seed": seed}, "turning"), model
    )
    return {
        "model": model,
        "seed": seed,
        "dice": list(scores.values()),
        "share": share(list(scores.values())),
    }


def share(scores: list[float]) -> float:
    """Part of the frames with a good Dice."""
    return sum(score >= GOOD for score in scores) / len(scores)


def tracking_of(recipe: MotionRecipe, model: str) -> Tracking:
    phantom = MovingPhantom(recipe)
    start = Volume(phantom.truth(0), phantom.geometry)
    return Tracking(
        phantom, TrackConfig(model=model, threads=1, energy="chan-vese", levels=1), objects=start
    )


def dice_of_frames(recipe: MotionRecipe, model: str) -> dict[int, float]:
    """Dice of all frames but the first; 0 where the object is not followed any more."""
    phantom, scores = MovingPhantom(recipe), dict.fromkeys(range(1, recipe.frames), 0.0)
    for result in tracking_of(recipe, model):
        if result.frame:
            scores[result.frame] = dice(result, phantom.truth(result.frame) > 0)
    return scores


def dice(result: FrameResult, truth: np.ndarray) -> float:
    """Dice of the first object in a frame, seen or coasting."""
    labels = result.labels(seen_only=False) == 1
    return float(2.0 * (labels & truth).sum() / max(1, labels.sum() + truth.sum()))


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean shares of each model by speed, noise and whether frames are hidden."""
    lines = []
    for speed, noise, hidden in itertools.product(
        sorted({row["speed"] for row in rows}), NOISE, (False, True)
    ):
        line: dict[str, Any] = {"speed": speed, "noise": noise, "hidden": hidden}
        for model in MODELS:
            own = [
                row
                for row in rows
                if (row["speed"], row["noise"], bool(row["hidden"]), row["model"])
                == (speed, noise, hidden, model)
            ]
            line[model] = round(statistics.mean(row["share"] for row in own), 3)
            if hidden:
                line[f"{model}, hidden frames"] = round(
                    statistics.mean(row["share_hidden"] for row in own), 3
                )
        lines.append(line)
    return lines


def cost(rounds: int) -> dict[str, float]:
    """Median over rounds of the seconds of a sequence, over those of the model without momentum in the same round."""
    recipe = recipe_of("translation", 2.0, 0.3, (), 0)
    ratios: dict[str, list[float]] = {model: [] for model in MODELS}
    for _ in range(rounds + 1):
        seconds = {}
        for model in MODELS:
            began = time.perf_counter()
            for _ in tracking_of(recipe, model):
                pass
            seconds[model] = time.perf_counter() - began
        for model in MODELS:
            ratios[model].append(seconds[model] / seconds["none"])
    return {model: round(statistics.median(values[1:]), 3) for model, values in ratios.items()}


def picture(rows: list[dict[str, Any]], path: Path) -> None:
    """Share of good frames against speed, a panel for each noise and for hidden frames."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    speeds = sorted({row["speed"] for row in rows})
    figure, axes = pyplot.subplots(1, 4, figsize=(15, 3.6), sharey=True)
    panels = [
        (0.3, False, "share", "all frames shown, noise .3"),
        (1.0, False, "share", "all frames shown, noise 1"),
        (0.3, True, "share_hidden", "three hidden frames, noise .3"),
        (1.0, True, "share_hidden", "three hidden frames, noise 1"),
    ]
    for axis, (noise, hidden, key, title) in zip(axes, panels, strict=True):
        for place, model in enumerate(MODELS):
            means = [
                statistics.mean(
                    row[key]
                    for row in rows
                    if row["model"] == model
                    and row["speed"] == speed
                    and row["noise"] == noise
                    and bool(row["hidden"]) == hidden
                )
                for speed in speeds
            ]
            axis.plot(
                np.array(speeds) * (1 + 0.02 * (place - 1.5)),
                means,
                "os^x"[place] + "-",
                label=model,
            )
        axis.set(
            xscale="log", xticks=speeds, xticklabels=[f"{one:g}" for one in speeds], title=title
        )
        axis.set_ylim(-0.03, 1.03)
        axis.set_xlabel("radii in ten frames")
        axis.minorticks_off()
    axes[0].set_ylabel("share of frames with Dice >= .9")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
