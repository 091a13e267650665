"""`square`, `rectangle`, `rectangle-accelerated`: the paper's figures 1 to 3 on curves.

Contrast 1, white noise of standard deviation 1 per pixel, Chan-Vese; the same step control for every flow.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.figures.common import COLOURS, FINE, Task, agreement, box, make, run_all, write

SIZE = 96
SQUARE = box((1, SIZE, SIZE), (0, 24, 24), (1, 72, 72), 1.0, 11)
RECTANGLE = box((1, SIZE, SIZE), (0, 28, 18), (1, 68, 78), 1.0, 0)
#: Pixels x, y, z: inside, in a corner, around.
STARTS = {
    "inside": "ball:48,48,0,8vox",
    "in a corner": "ball:28,36,0,6vox",
    "around": "ball:48,48,0,40vox",
}
STEPS = {"max_steps": 600, **FINE}


def square(output: Path) -> None:
    """Gradient (stuck), gradient with an area weight (round corners), Sobolev, from around the square."""
    rows: dict[str, dict[str, Any]] = {
        "gradient": {"flow": "gradient"},
        "gradient, area weight 0.2 mm": {"flow": "gradient", "smoothness": 0.2, "max_steps": 3000},
        "Sobolev, 10 mm": {"flow": "sobolev:length=10"},
        "constant density": {"flow": "constant-density"},
    }
    tasks = [
        Task((name,), SQUARE, {"start": STARTS["around"], **STEPS, **changes})
        for name, changes in rows.items()
    ]
    results = run_all(tasks, tell)
    truth, image = make(SQUARE)
    figure, axes = plt.subplots(1, len(rows), figsize=(3.2 * len(rows), 3.7))
    for axis, record in zip(axes, results, strict=True):
        show(axis, image, truth, [record["labels"]])
        figures = f"Dice {record['dice']:.3f}, at corners {record['corner_dice']:.3f}"
        axis.set_title(f"{record['name'][0]}\n{figures}", fontsize=9)
    save(figure, output, "square", "Noisy square, start around it (dashed: truth)")
    write(output, "square", {"shape": SQUARE, "start": STARTS["around"], "runs": results})


def rectangle(output: Path) -> None:
    """Three starts under descent, at most 600 steps: two are cut off."""
    three(output, "rectangle", {"flow": "gradient"}, "Descent from three starts")


def rectangle_accelerated(output: Path) -> None:
    """The same starts and energy with momentum: one minimiser."""
    three(
        output,
        "rectangle-accelerated",
        {"flow": "constant-density"},
        "Constant density from three starts",
    )


def three(output: Path, name: str, changes: dict[str, Any], title: str) -> None:
    """Run the three starts of the rectangle; a column each, and all together."""
    tasks = [
        Task((start,), RECTANGLE, {"start": where, **STEPS, **changes})
        for start, where in STARTS.items()
    ]
    results = run_all(tasks, tell)
    labels = [record["labels"] for record in results]
    pairs = agreement(labels)
    truth, image = make(RECTANGLE)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.7))
    for axis, record, colour in zip(axes, results, COLOURS, strict=False):
        show(axis, image, truth, [record["labels"]], [colour])
        title = f"{record['name'][0]}: Dice {record['dice']:.3f}\n{record['steps']} steps, {record['stop']}"
        axis.set_title(title, fontsize=9)
    show(axes[3], image, truth, labels, COLOURS)
    axes[3].set_title(
        "all three; pairwise Dice\n" + ", ".join(f"{p:.3f}" for p in pairs), fontsize=9
    )
    save(figure, output, name, f"{title} on a noisy rectangle (dashed: truth)")
    print("pairwise Dice:", ", ".join(f"{p:.3f}" for p in pairs))
    write(
        output,
        name,
        {"shape": RECTANGLE, "starts": STARTS, "pairwise_dice": pairs, "runs": results},
    )


def tell(record: dict[str, Any]) -> None:
    """Print a run as it ends."""
    name = " / ".join(str(part) for part in record["name"])
    print(
        f"{name:60s} Dice {record['dice']:.3f} corners {record['corner_dice']:.3f} "
        f"steps {record['steps']:4d} {record['stop']}, {record['seconds']:.1f} s",
        flush=True,
    )


def show(
    axis: Any,
    image: np.ndarray,
    truth: np.ndarray,
    labels: list[np.ndarray],
    colours: Any = COLOURS,
) -> None:
    """One slice of the image with contours; the truth dashed."""
    middle = image.shape[0] // 2
    axis.imshow(image[middle], cmap="gray", vmin=-2, vmax=3)
    axis.contour(truth[middle], [0.5], colors="white", linestyles="--", linewidths=0.9)
    for one, colour in zip(labels, colours, strict=False):
        if one[middle].any():
            axis.contour(one[middle], [0.5], colors=[colour], linewidths=1.6)
    axis.set_axis_off()


def save(figure: Any, output: Path, name: str, title: str) -> None:
    """Save a picture as PNG."""
    figure.set_layout_engine("constrained")
    figure.suptitle(title, fontsize=10)
    figure.savefig(output / f"{name}.png", dpi=110)
    plt.close(figure)
