"""What the figures share: noisy shapes with their truth, runs in two processes, corners, JSON beside the picture."""

from __future__ import annotations

import itertools
import json
import os
import platform
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.api.segment import Result, segment
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice, evaluate
from accelsurf.settings.run_config import RunConfig

PROCESSES = 2
#: Colours that the colour-blind tell apart.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
#: The fastest place sets the step, in small steps: what traps descent is not hopped over. The same for every flow.
FINE: dict[str, Any] = {"cfl": 0.25, "percentile": 100.0}


class Task(NamedTuple):
    """One run: a name for it, the shape's recipe, the settings."""

    name: tuple[Any, ...]
    shape: tuple[Any, ...]
    settings: dict[str, Any]


def box(
    shape: tuple[int, ...], low: tuple[int, ...], high: tuple[int, ...], noise: float, seed: int
) -> tuple:
    """Recipe of a box of ones in zeros (voxels ``low`` to ``high``), with white noise."""
    return shape, low, high, noise, seed


def make(recipe: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Truth (bool) and image (float32) of a recipe."""
    shape, low, high, noise, seed = recipe
    truth = np.zeros(shape, bool)
    truth[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    image = truth + np.random.default_rng(seed).normal(0.0, noise, shape)
    return truth, image.astype(np.float32)


def corner_dice(labels: np.ndarray, truth: np.ndarray, reach: int = 5) -> float:
    """Dice within ``stencil_width`` voxels of the box's edges: where two of its faces (sides) meet."""
    low, high = (f(np.argwhere(truth), axis=0) for f in (np.min, np.max))
    axes = [axis for axis, n in enumerate(truth.shape) if n > 1]
    edges = np.zeros(truth.shape, bool)
    for a, b in itertools.combinations(axes, 2):
        for ends in itertools.product((low, high), repeat=2):
            index: list[Any] = [slice(i, j + 1) for i, j in zip(low, high, strict=True)]
            index[a], index[b] = ends[0][a], ends[1][b]
            edges[tuple(index)] = True
    near = ndimage.distance_transform_edt(~edges) <= reach
    return dice(labels[near], truth[near])


def run(task: Task) -> dict[str, Any]:
    """Run a task; its figures, and the labels packed."""
    truth, image = make(task.shape)
    began = time.perf_counter()
    # The paper's energy: nothing of the area that noise asks for.
    settings = {"levels": 1, "threads": 1, "energy": "chan-vese:area=0", **task.settings}
    result: Result = segment(image, config=RunConfig(**settings))
    seconds = time.perf_counter() - began
    labels = result.labels.astype(bool)
    record: dict[str, Any] = {
        "name": task.name,
        "dice": dice(labels, truth),
        "corner_dice": corner_dice(labels, truth),
        "hausdorff_mm": None,
        "energy": result.history[-1].potential,
        "steps": result.stop.steps,
        "stop": result.stop.reason,
        "cells_visited": sum(row.cells_visited for row in result.history),
        "seconds": seconds,
        "mass_correction": result.history[-1].mass_correction,
        "labels": labels,
    }
    if labels.any():
        pair = (Volume.from_array(array.astype(np.uint8), 1.0) for array in (labels, truth))
        record["hausdorff_mm"] = evaluate(*pair).hausdorff_mm
    return record


def run_all(
    tasks: Iterable[Task], on_done: Callable[[dict[str, Any]], None] | None = None
) -> list[dict[str, Any]]:
    """Run tasks side by side, in order; ``on_done`` is called with each result."""
    results = []
    with ProcessPoolExecutor(min(PROCESSES, os.cpu_count() or 1)) as pool:
        for record in pool.map(run, tasks):
            results.append(record)
            if on_done is not None:
                on_done(record)
    return results


def agreement(labels: list[np.ndarray]) -> list[float]:
    """Dice of every pair."""
    return [dice(a, b) for a, b in itertools.combinations(labels, 2)]


def write(output: Path, name: str, record: dict[str, Any]) -> None:
    """Write the figures of a figure as JSON; arrays stay out."""
    document = {
        "figure": name,
        "machine": {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
        },
        **record,
    }
    path = output / f"{name}.json"
    path.write_text(json.dumps(plain(document), indent=1) + "\n")
    print(f"written: {path}")


def plain(value: Any) -> Any:
    """A value as JSON takes it: floats of six digits, null where they are not finite, no arrays."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items() if not isinstance(v, np.ndarray)}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value if not isinstance(v, np.ndarray)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value
