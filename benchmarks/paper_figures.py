"""The paper's experiments, one by one or all: a picture and its numbers as JSON each, into docs/figures."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

from benchmarks.figures.cube import cube
from benchmarks.figures.planar import rectangle, rectangle_accelerated, square
from benchmarks.figures.solutions import exact_solutions
from benchmarks.figures.speed import speed
from benchmarks.figures.tuned import tuned

ROOT = Path(__file__).resolve().parent.parent
FIGURES = {
    "square": square,
    "rectangle": rectangle,
    "rectangle-accelerated": rectangle_accelerated,
    "cube": cube,
    "tuned": tuned,
    "speed": speed,
    "exact": exact_solutions,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="+", choices=[*FIGURES, "all"])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "figures")
    options = parser.parse_args()
    matplotlib.use("Agg")
    options.output.mkdir(parents=True, exist_ok=True)
    for name in FIGURES if "all" in options.name else options.name:
        print(f"== {name}", flush=True)
        FIGURES[name](options.output)


if __name__ == "__main__":
    main()
