"""Tables that studies write into pages of docs, between two comments that name the study; figures in the pages' prose.

``python -m benchmarks.pages`` compares `FIGURES` with the results that are kept: exit code 1 when one differs.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

END = "<!-- end of the table -->"
ROOT = Path(__file__).resolve().parents[1]


class Figures(NamedTuple):
    """Numbers in the text of a ``page``, and where each was measured.

    ``text`` is a regular expression with a group for each number. ``source`` is JSON, and ``keys`` has the keys that
    lead to each number, with "/" between them and "%" before them where it is given in percent; or it is another page,
    and a key is an expression with one group.
    """

    page: str
    text: str
    source: str
    keys: tuple[str, ...]


_N = r"(\d*\.?\d+)"
_RESULTS, _CLICKS, _CT = "benchmarks/results", "figures/plain/accelsurf/all", "512x512x300 ct"
_DRAWN = ("stroke in a slice", "slices by the wheel", "grey values by a drag")
_SERVED = (
    ("point", "point"),
    ("box", "bbox"),
    ("scribble", "scribble"),
    ("lasso", "lasso"),
    ("labels", "labels"),
)
_MEASURED = ("volume_mm3", "area_mm2", "diameter_mm")
_HELD = {
    "all": "all/all",
    **{
        name: f"shape/{name.removesuffix(' *')}"
        for name in (
            *("ball", "box", "cylinder *", "ellipsoid", "lobes *"),
            *("potato *", "torus", "tube", "turned box"),
        )
    },
    **{f"slices of {n} mm": f"slices/{n} mm" for n in (1, 3, 5)},
    **{f"noise {text}": f"noise/0{text}" for text in (".05", ".1", ".2", ".3")},
    "fading contrast": "image/fading",
    "a neighbour": "image/neighbour",
    "even contrast": "image/plain",
}
_BRAIN = ("accelsurf", "c3d -levelset", "Gaussian, Otsu, largest part")
FIGURES = (
    Figures(
        "README.md",
        f"Dice {_N} after one click .*? {_N} after two, {_N} after three, {_N} after five; {_N} % of the",
        f"{_RESULTS}/clicks.json",
        (*(f"{_CLICKS}/dice/{clicks}" for clicks in "1235"), f"%{_CLICKS}/within5"),
    ),
    Figures(
        "README.md",
        rf"\({_N} if the person takes the best",
        "docs/explanation/click-benchmark.md",
        (rf"best of its answers[^|]*\| {_N}",),
    ),
    Figures(
        "README.md",
        rf"spleen in CT, .*?Dice {_N}",
        "docs/tutorial/by-clicks.md",
        (f"tutorial spleen -->{_N}",),
    ),
    Figures(
        "README.md",
        rf"Dice {_N} in {_N} s \(`--preset .*?\(c3d\) {_N} in {_N} s; .*? {_N} in {_N} s",
        f"{_RESULTS}/benchmark_segment-real.json",
        tuple(f"programs/{name}/{key}" for name in _BRAIN for key in ("dice", "median_s")),
    ),
    Figures(
        "README.md",
        rf"descent finds the box in {_N} of 5, momentum in {_N} of 5",
        "docs/explanation/paper.md",
        tuple(
            rf"\| core 2\.6 {before}\| {_N} of 5"
            for before in (r"\|[^|]*\|[^|]*", r"\|[^|]*\|[^|]*\|[^|]*")
        ),
    ),
    Figures(
        "docs/how-to/viewer.md",
        rf"slowed the solver by {_N} % and answered keys after {_N} ms \(median; {_N} at",
        f"{_RESULTS}/viewer.json",
        ("%slowdown/window", "key_answered_ms/median", "key_answered_ms/largest"),
    ),
    Figures(
        "docs/viewer.md",
        rf"{_N} {_N} {_N} {_N} s for four strokes .*?\({_N} {_N} {_N} {_N} s at 256",
        f"{_RESULTS}/viewer_strokes.json",
        tuple(f"{size}/obeyed_s/{number}" for size in (_CT, "256x256x256") for number in range(4)),
    ),
    Figures(
        "docs/viewer.md",
        rf"stroke after {_N} ms \({_N} at .*?after {_N} ms \({_N}\), grey values after {_N} ms \({_N}\)",
        f"{_RESULTS}/viewer_strokes.json",
        tuple(f"{size}/{what}/median_ms" for what in _DRAWN for size in (_CT, "256x256x256")),
    ),
    *(
        Figures(
            "docs/how-to/slicer-and-napari.md",
            rf"\| {name} \| {_N} \({_N}\) \| {_N} \({_N}\) \|",
            f"{_RESULTS}/serve.json",
            tuple(
                f"summary/{when} {kind}/{key}"
                for when in ("first", "later, after")
                for key in ("median", "95 %")
            ),
        )
        for name, kind in _SERVED
    ),
    Figures(
        "docs/explanation/trust.md",
        rf"\({_N} of `segment`, {_N} of `refine`, {_N} of `track`, {_N} of `movie`, {_N} of `batch`",
        f"{_RESULTS}/kills.json",
        ("kills/runs", "refine/runs", "track/runs", "movie/runs", "batch/batches"),
    ),
    *(
        Figures(
            "docs/explanation/measures.md",
            rf"\| {re.escape(name)} \| {_N} " + rf"\| {_N} %, {_N} % (?:\(\d+ not told\) )?" * 3,
            f"{_RESULTS}/intervals.json",
            (
                f"counted/report/volume_mm3/{group}/count",
                *(
                    part + f"counted/report/{measure}/{group}/{figure}"
                    for measure in _MEASURED
                    for part, figure in (("%", "holds"), ("", "half_width_percent"))
                ),
            ),
        )
        for name, group in _HELD.items()
    ),
)


def compared(figures: Figures) -> list[tuple[str, float, str]]:
    """Return each number of a page as it stands there, as it was measured, and the key that led to it.

    Raises
    ------
    LookupError
        When the page has no such text, or its source no such number.
    """
    found = re.search(
        figures.text, " ".join((ROOT / figures.page).read_text(encoding="utf-8").split())
    )
    if found is None or len(found.groups()) != len(figures.keys):
        raise LookupError(f"{figures.page}: has no {figures.text!r}")
    return [
        (
            said,
            100 * measured(figures.source, key[1:])
            if key.startswith("%")
            else measured(figures.source, key),
            key,
        )
        for said, key in zip(found.groups(), figures.keys, strict=True)
    ]


def agree(said: str, value: float) -> bool:
    """True where a number is what was measured, rounded to its digits.

    Examples
    --------
    >>> agree(".65", 0.65408), agree("0.18", 0.175), agree("49", 50.2)
    (True, True, False)
    """
    return abs(float(said) - value) <= 0.5000001 * 10.0 ** -len(said.partition(".")[2])


def measured(source: str, key: str) -> float:
    """Return the number that a key leads to."""
    text = (ROOT / source).read_text(encoding="utf-8")
    if source.endswith(".md"):
        found = re.search(key, text)
        if found is None:
            raise LookupError(f"{source}: has no {key!r}")
        return float(found[1])
    value = json.loads(text)
    for part in key.split("/"):
        value = value[int(part)] if isinstance(value, list) else value[part]
    return float(value)


def put_table(page: Path, study: str, text: str, command: str = "scripts/study") -> None:
    """Put what a study found in place of what stands between its comments."""
    begin = f"<!-- {command} {study} writes this table -->"
    before, rest = page.read_text().split(begin)
    page.write_text(f"{before}{begin}\n\n{text}\n{END}{rest.split(END, 1)[1]}")


def row_of(cells: Iterable[str]) -> str:
    """A row of a table in Markdown.

    Examples
    --------
    >>> row_of(["a", "b"])
    '| a | b |'
    """
    return f"| {' | '.join(cells)} |"


def head_of(columns: tuple[str, ...]) -> list[str]:
    """The rows above a table's own."""
    return [row_of(columns), "|" + "---|" * len(columns)]


def main() -> int:
    """Print each number and where it is from."""
    wrong = 0
    for figures in FIGURES:
        for said, value, key in compared(figures):
            mark = "   " if agree(said, value) else "NOT"
            wrong += mark == "NOT"
            print(f"{mark} {figures.page}: {said}, {figures.source}: {value:g} ({key})")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
