"""What a person would have seen: after each click the slice through it, with result, reference and click."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import bounding_box
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks.person import Mask, PersonClick

#: Voxels around the object that are shown, as a part of its extent; pictures beyond so many are left out.
AROUND, MOST = 0.4, 10
FOUND, REFERENCE = "#E69F00", "#56B4E9"


class Frame(NamedTuple):
    """One picture: the slice's values, result and reference, where the click is in it, and a line of text."""

    values: NDArray[Any]
    found: Mask
    truth: Mask
    at: tuple[float, float]
    side: str
    text: str


@dataclass
class Album:
    """The pictures of one game."""

    method: str
    name: str
    kind: str
    frames: list[Frame] = field(default_factory=list)
    aspect: float = 1.0
    window: tuple[float, float] = (0.0, 1.0)

    def watcher(self, image: Volume, truth: Mask) -> Callable[[PersonClick, Mask], None]:
        """What a game calls after each click."""
        box = bounding_box(truth)
        assert box is not None
        # The slice across the axis of the largest spacing, of many thin ones the first.
        axis = int(np.argmax(image.geometry.spacing))
        sides = [i for i in range(3) if i != axis]
        self.aspect = image.geometry.spacing[sides[0]] / image.geometry.spacing[sides[1]]
        # The window: the object's own range of values, and as much again to both sides.
        low, high = np.percentile(image.array[truth], (1, 99))
        self.window = float(2 * low - high), float(2 * high - low)
        shown = []
        for i in sides:
            margin = int(AROUND * (box[i].stop - box[i].start)) + 5
            shown.append(
                slice(max(box[i].start - margin, 0), min(box[i].stop + margin, truth.shape[i]))
            )

        def watch(click: PersonClick, labels: Mask) -> None:
            if len(self.frames) == MOST:
                return
            part: list[Any] = [click.index[axis]] * 3
            part[sides[0]], part[sides[1]] = shown
            cut = tuple(part)
            at = (click.index[sides[1]] - shown[1].start, click.index[sides[0]] - shown[0].start)
            text = f"{len(self.frames) + 1}: {click.side}, Dice {dice(labels, truth):.3f}"
            values = np.array(image.array[cut], np.float32)
            self.frames.append(Frame(values, labels[cut].copy(), truth[cut], at, click.side, text))

        return watch

    def write(self, folder: Path) -> Path:
        """Write all pictures as one."""
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        count = len(self.frames)
        columns = min(count, 5)
        rows = -(-count // columns)
        figure, axes = plt.subplots(
            rows, columns, figsize=(3.0 * columns, 3.2 * rows), squeeze=False
        )
        for axis in axes.flat:
            axis.set_axis_off()
        for axis, frame in zip(axes.flat, self.frames, strict=False):
            axis.imshow(
                frame.values,
                cmap="gray",
                vmin=self.window[0],
                vmax=self.window[1],
                aspect=self.aspect,
            )
            for mask, colour, style in ((frame.truth, REFERENCE, "--"), (frame.found, FOUND, "-")):
                if mask.any() and not mask.all():
                    axis.contour(mask, [0.5], colors=colour, linewidths=1.2, linestyles=style)
            axis.plot(
                *frame.at, "+" if frame.side == "inside" else "x", color="#D55E00", markersize=9
            )
            axis.set_title(frame.text, fontsize=9)
        figure.suptitle(
            f"{self.name}: {self.method}, {self.kind} (result solid, reference dashed)", fontsize=10
        )
        figure.tight_layout()
        path = folder / f"clicks_{self.method}_{self.name}_{self.kind}.png"
        figure.savefig(path, dpi=80)
        plt.close(figure)
        return path
