"""RESULTS.md and the pictures, from the JSON files alone."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.figures.common import COLOURS

#: The order in which they are shown.
NAMES = (
    "march",
    "advance",
    "segment-noise",
    "segment-hard",
    "segment-real",
    "regularised",
    "step",
    "memory",
    "start",
    "threads",
)
NOTES = Path(__file__).with_name("notes.toml")
PREFIX = "benchmark_"


def json_path(folder: Path, name: str) -> Path:
    """Where the JSON of a benchmark lies."""
    return folder / f"{PREFIX}{name}.json"


def load(folder: Path) -> dict[str, dict[str, Any]]:
    """Every result in a folder, in the order of `NAMES`."""
    paths = {name: json_path(folder, name) for name in NAMES}
    return {name: json.loads(path.read_text()) for name, path in paths.items() if path.is_file()}


def number(value: Any, digits: int = 3) -> str:
    """A figure as one reads it: three significant digits, whole numbers whole."""
    if value is None:
        return "-"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "-"
    if 0 < abs(value) < 1 and abs(value) > 0.9:
        return f"{value:.4f}"  # a Dice
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def measured(entry: dict[str, Any], key: str = "measured") -> str:
    """A figure of a goal with its unit."""
    unit = entry["unit"]
    space = "" if unit in ("x", "%", "") else " "
    return number(entry[key]) + (f"{space}{unit}" if entry[key] is not None else "")


def reached(entry: dict[str, Any]) -> bool | None:
    """Whether a goal is reached; None where it could not be measured."""
    got, wanted = entry["measured"], entry["wanted"]
    if got is None:
        return None
    return bool(got >= wanted if entry["sense"] == ">=" else got <= wanted)


def verdict(entry: dict[str, Any]) -> str:
    """Yes, or no and by how much short."""
    done = reached(entry)
    got = entry["measured"]
    wanted = entry["wanted"]
    if done is None:
        return "not measured"
    if done:
        return "yes"
    # A factor that is read as 1 says nothing.
    if wanted <= 0 or got <= 0 or abs(got / wanted - 1.0) < 0.01:
        return f"no, short by {number(abs(wanted - got))}"
    factor = wanted / got if entry["sense"] == ">=" else got / wanted
    return f"no, {number(factor)} times {'too little' if entry['sense'] == '>=' else 'too much'}"


def markdown(
    results: dict[str, dict[str, Any]], notes: dict[str, str], pictures: str = "results"
) -> str:
    """RESULTS.md of some results."""
    lines = ["# accelsurf beside its peers", ""]
    lines += [
        "Made by `scripts/benchmark`, rendered from the JSON files in `results` (`scripts/benchmark --render`)."
    ]
    lines += ["[README.md](README.md) says how to read it.", ""]
    lines += ["| benchmark | work | wanted | measured | reached |", "|---|---|---|---|---|"]
    for name, result in results.items():
        for i, entry in enumerate(result["goals"]):
            sense = "" if entry["sense"] == ">=" else "at most "
            title, work = (f"[{name}](#{name})", result["work"]) if i == 0 else ("", "")
            wanted = f"{entry['what']}: {sense}{measured(entry, 'wanted')}"
            lines.append(f"| {title} | {work} | {wanted} | {measured(entry)} | {verdict(entry)} |")
    missing = [name for name in NAMES if name not in results]
    if missing:
        lines += ["", f"Not run: {', '.join(missing)}."]
    lines += ["", *machines(results)]
    for name, result in results.items():
        lines += ["", f"## {name}", "", f"{result['work'][0].upper()}{result['work'][1:]}."]
        if result.get("quick"):
            lines += ["", "*Tiny sizes (`--quick`): the figures mean nothing.*"]
        if notes.get(name):
            lines += ["", notes[name].strip()]
        for each in result["tables"]:
            lines += ["", f"**{each['title']}**", "", *as_markdown(each)]
        if result["pairs"]:
            pairs = [
                {
                    "columns": ["pair", "ratio"],
                    "rows": [(p["pair"], p["ratio"]) for p in result["pairs"]],
                }
            ]
            lines += ["", *as_markdown(pairs[0])]
        for message in result.get("messages", []):
            lines += ["", f"* {message}"]
        if result.get("picture"):
            lines += ["", f"![{name}]({pictures}/{result['picture']})"]
    return "\n".join(lines) + "\n"


def as_markdown(each: dict[str, Any]) -> list[str]:
    """A table's lines."""
    columns, rows = each["columns"], each["rows"]
    kinds = [all(not isinstance(row[i], str) for row in rows) for i in range(len(columns))]
    head = [
        f"| {' | '.join(columns)} |",
        f"|{'|'.join('---:' if numeric else '---' for numeric in kinds)}|",
    ]
    return head + [f"| {' | '.join(number(value) for value in row)} |" for row in rows]


def machines(results: dict[str, dict[str, Any]]) -> list[str]:
    """Where and when; each benchmark that was made elsewhere or at another version has its own line."""
    groups: dict[str, list[str]] = {}
    for name, result in results.items():
        m = result["machine"]
        packages = ", ".join(f"{p} {v}" for p, v in m["packages"].items() if v)
        caches = ", ".join(f"{level} {size}" for level, size in m["caches"].items())
        text = f"{m['processor']}, {m['cores']} cores, {m['memory_gb']} GB, {caches}; {m['system']}"
        text += f"; Python {m['python']}, {packages}; commit {m['commit']}"
        groups.setdefault(text, []).append(f"{name} ({m['date']})")
    return [f"* {', '.join(names)}: {text}" for text, names in groups.items()]


def render(folder: Path, target: Path, notes: Path = NOTES) -> Path:
    """Write RESULTS.md."""
    results = load(folder)
    texts = tomllib.loads(notes.read_text()) if notes.is_file() else {}
    pictures = folder.name if folder.parent == target.parent else "."
    target.write_text(markdown(results, texts, pictures))
    return target


def picture(folder: Path, name: str, result: dict[str, Any]) -> str | None:
    """Draw a result's bars or curves; the file's name."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    if "curves" in result:
        figure, axis = plt.subplots(figsize=(7, 4.2))
        curves = result["curves"]
        for i, (label, points) in enumerate(curves["lines"].items()):
            if points:
                axis.loglog(
                    *zip(*points, strict=True),
                    marker="os^D"[i % 4],
                    color=COLOURS[i % 6],
                    label=label,
                )
        axis.set_xlabel(curves["x"])
        axis.set_ylabel(curves["y"])
        axis.legend(fontsize=8)
    elif result.get("bars"):
        labels, seconds = zip(*result["bars"], strict=True)
        figure, axis = plt.subplots(figsize=(8, 1.2 + 0.28 * len(labels)))
        own = [COLOURS[0] if "accelsurf" in label else COLOURS[1] for label in labels]
        axis.barh(range(len(labels)), seconds, color=own)
        axis.set_yticks(range(len(labels)), labels, fontsize=8)
        axis.invert_yaxis()
        positive = [s for s in seconds if s > 0]
        if positive and max(positive) > 30 * min(positive):
            axis.set_xscale("log")
        axis.set_xlabel(result.get("bars_unit", "seconds, median"))
    else:
        return None
    axis.grid(True, axis="x", alpha=0.3)
    axis.set_title(name, fontsize=10)
    figure.tight_layout()
    path = folder / f"{PREFIX}{name}.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path.name
