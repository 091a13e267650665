"""Two runs on one image, without and with momentum, in one picture: made by scripts/demo.

The image is a bright box with a core 2.6 times as bright, in noise. The energy of two means has a minimum around the
core: descent stays there, momentum carries the surface over it to the box. The range of brightness in which the two
differ is narrow: docs/explanation/paper.md has it.
"""

import sys
import time

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import accelsurf

SIDE, MIDDLE = 48, 23.5
FLOWS = {"descent": "gradient", "momentum": "constant-density"}


def scan(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the image and the box, arrays (48, 48, 48)."""
    z, y, x = np.indices((SIDE, SIDE, SIDE)) - MIDDLE
    box = (np.abs(z) < 12) & (np.abs(y) < 14) & (np.abs(x) < 13)
    core = z**2 + y**2 + x**2 < 7.0**2
    noise = np.random.default_rng(seed).normal(0.0, 0.1, box.shape)
    return box + 1.6 * core + noise, box


def main(path: str, seed: int = 0) -> None:
    """Run both flows, print how they ended, and draw them."""
    image, box = scan(seed)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    left.imshow(image[SIDE // 2], cmap="gray", vmin=-0.2, vmax=2.8)
    left.set(title="Middle slice, and where the surface rests", xticks=[], yticks=[])
    for (name, flow), color in zip(FLOWS.items(), ("tab:orange", "tab:blue"), strict=True):
        began = time.perf_counter()
        result = accelsurf.segment(
            image,
            start=f"ball:{MIDDLE + 3},{MIDDLE - 1},{MIDDLE + 2},6vox",
            energy="chan-vese:area=0",
            flow=flow,
            levels=1,
            max_steps=400,
        )
        found = result.labels > 0
        dice = 2 * (found & box).sum() / (found.sum() + box.sum())
        seconds = time.perf_counter() - began
        print(f"{name}: {result.stop.steps} steps, {seconds:.1f} s, Dice {dice:.3f} with the box")
        left.contour(result.psi[SIDE // 2], [0.0], colors=color, linewidths=2)
        history = result.history
        right.plot(
            [row.step for row in history],
            [row.potential for row in history],
            color=color,
            label=f"{name}: Dice {dice:.2f}",
        )
    right.set(title="Energy, which both lower", xlabel="step", ylabel="energy")
    right.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(sys.argv[1])
