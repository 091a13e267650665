"""What the games come to: JSON of all figures, tables in Markdown for the docs, a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.clicks.games import BUDGETS, LEVELS, clicks_to, dice_after, summary, variants
from benchmarks.clicks.methods import METHODS, OWN
from benchmarks.clicks.objects import HALVES, chosen
from benchmarks.clicks.store import Store, key_of
from benchmarks.figures.common import COLOURS, plain
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import goal, machine
from benchmarks.peers.render import measured, verdict

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "explanation" / "click-benchmark.md"
#: Kinds of games, and how the tables call them.
KINDS = {
    "plain": "exact clicks", "size": "exact clicks, and a size 25 % too large or 20 % too small",
    "jitter": "jittered clicks, five seeds",
}
#: The halves, as headings call them.
TITLES = {"tune": "Half to tune on", "report": "Half to report"}
#: Goals of the reporting half: Dice after so many clicks, with exact clicks.
WANTED = {1: 0.75, 5: 0.90}


def write(folder: Path, page: Path | None) -> list[Path]:
    """Write JSON, tables and picture beside the games, and the tables into a page of the docs too; what was written."""
    games = {half: {kind: collected(folder, half, kind) for kind in KINDS} for half in HALVES}
    figures = {
        half: {kind: {name: summary(list(own.values())) for name, own in methods.items()}
               for kind, methods in kinds.items() if methods}
        for half, kinds in games.items()
    }
    settings = {name: METHODS[name].settings(Store(folder, name)) for name in METHODS}
    goals = goals_of(figures["report"])
    facts = plain({"machine": machine(), "settings": settings, "goals": goals, "figures": figures})
    target = folder / "clicks.json"
    target.write_text(json.dumps(facts, indent=1) + "\n")
    text = text_of(figures, games, goals, settings)
    own = folder / "clicks.md"
    own.write_text(text)
    if page is not None:
        put_table(page, "clicks", text, "scripts/benchmark")
    return [target, own, *([page] if page is not None else []), *picture(folder, figures)]


def collected(folder: Path, half: str, kind: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Method -> object and variant -> game, of the methods that played all of the half at their best settings."""
    out = {}
    for name, method in METHODS.items():
        store = Store(folder, name)
        settings = method.settings(store)
        if settings is None:
            continue
        keys = {(one.name, variant): key_of(one.name, variant, settings)
                for one in chosen(half) for variant in variants([kind])}
        games = {f"{key[0]} {key[1]}": game for key, text in keys.items() if (game := store.played(text)) is not None}
        if len(games) == len(keys):
            out[name] = games
    return out


def goals_of(figures: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What is to be reached on the reporting half, and what was."""
    own = figures.get("plain", {}).get("accelsurf", {})
    peers = [one for name, one in figures.get("plain", {}).items() if name not in OWN]
    dice = own.get("dice", {})
    sized = figures.get("size", {}).get("accelsurf", {}).get("dice", {})
    goals = [
        goal("median number of clicks to .85", 3, own.get("noc", {}).get(0.85), "<=", ""),
        goal("objects at .85 within five clicks", 0.8, own.get("within5"), ">=", ""),
        *(goal(f"median Dice after {_count(n)}", level, dice.get(n), ">=", "") for n, level in WANTED.items()),
        goal("median Dice after one click and a size", 0.82, sized.get(1), ">=", ""),
        goal("clicks after which the Dice fell by more than .02", 0.05, own.get("fell"), "<=", ""),
        goal("median wall seconds of the first click", 3.0, own.get("first_wall_s"), "<=", "s"),
    ]
    for n in BUDGETS:
        best = max((one["dice"][n] for one in peers if n in one["dice"]), default=None)
        if best is not None:
            goals.append(goal(f"median Dice after {_count(n)}, as the best peer's", best, dice.get(n), ">=", ""))
    return goals


def _count(clicks: int) -> str:
    return "one click" if clicks == 1 else f"{clicks} clicks"


def text_of(
    figures: Mapping[str, Any], games: Mapping[str, Any], goals: list[dict[str, Any]],
    settings: Mapping[str, dict[str, Any] | None],
) -> str:
    """All tables in Markdown."""
    lines = ["## Goals, on the half to report", "", *head_of(("goal", "wanted", "measured", "reached"))]
    for one in goals:
        sense = "at most " if one["sense"] == "<=" else "at least "
        lines.append(row_of((one["what"], sense + measured(one, "wanted"), measured(one), verdict(one))))
    for half in HALVES:
        for kind, methods in figures[half].items():
            lines += ["", f"## {TITLES[half]}: {KINDS[kind]}", "", *method_rows(methods)]
        if "plain" in figures[half]:
            lines += ["", f"## {TITLES[half]}: each object, exact clicks", "", *object_rows(games[half]["plain"])]
    chosen_ones = {name: one for name, one in settings.items() if one}
    lines += ["", "## Settings, the best on the half to tune on", "", *head_of(("method", "settings"))]
    lines += [row_of((name, ", ".join(f"{k} {v:g}" for k, v in one.items()))) for name, one in chosen_ones.items()]
    return "\n".join(lines) + "\n"


def method_rows(methods: Mapping[str, dict[str, Any]]) -> list[str]:
    """A row of medians per method."""
    head = ("method", *(f"Dice {n}" for n in BUDGETS), *(f"clicks to {level:.2f}" for level in LEVELS),
            "within 5", "fell", "s first", "s later", "CPU s")
    lines = head_of(head)
    for name, one in methods.items():
        dice = [f"{one['dice'][n]:.3f}" if n in one["dice"] else "" for n in BUDGETS]
        noc = [noc_text(one["noc"][level], one["played"]) for level in LEVELS]
        within = "" if one["within5"] is None else f"{one['within5']:.0%}"
        units = "first_wall_s", "later_wall_s", "later_cpu_s"
        times = ["" if one[key] is None else f"{one[key]:.2f}" for key in units]
        lines.append(row_of((name, *dice, *noc, within, f"{one['fell']:.1%}", *times)))
    return lines


def noc_text(clicks: float | None, played: int) -> str:
    """A number of clicks; "20+" where it took more than were played.

    Examples
    --------
    >>> noc_text(2.5, 20), noc_text(21, 20)
    ('2.5', '20+')
    """
    return f"{played}+" if clicks is None or clicks > played else f"{clicks:g}"


def object_rows(methods: Mapping[str, Mapping[str, dict[str, Any]]]) -> list[str]:
    """A row per object: ours, its start alone, and the best peer by the Dice after five clicks."""
    head = ("object", "Dice 1", "Dice 5", "last", "clicks to .85", "start alone, Dice 5", "best peer, Dice 5")
    lines = head_of(head)
    for key in next(iter(methods.values())):
        own, start = methods.get("accelsurf", {}).get(key), methods.get("accelsurf-start", {}).get(key)
        peers = {name: dice_after(games[key], 5) or 0.0 for name, games in methods.items() if name not in OWN}
        best = max(peers, key=lambda name: peers[name], default="")
        cells = ["", "", "", ""]
        if own is not None:
            cells = [_dice(own, 1), _dice(own, 5), _dice(own, len(own["clicks"])),
                     noc_text(clicks_to(own, 0.85), len(own["clicks"]))]
        lines.append(row_of((key.split()[0], *cells, "" if start is None else _dice(start, 5),
                             f"{peers[best]:.3f} ({best})" if best else "")))
    return lines


def _dice(game: dict[str, Any], budget: int) -> str:
    value = dice_after(game, budget)
    return "" if value is None else f"{value:.3f}"


def picture(folder: Path, figures: Mapping[str, Any]) -> list[Path]:
    """Median Dice over the number of clicks, a panel for each half that was played."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    halves = [half for half in HALVES if "plain" in figures[half]]
    if not halves:
        return []
    figure, axes = plt.subplots(1, len(halves), figsize=(5.6 * len(halves), 4.4), squeeze=False, sharey=True)
    for axis, half in zip(axes[0], halves, strict=True):
        for name, one in figures[half]["plain"].items():
            # A method has one colour in all panels.
            i, own = list(METHODS).index(name), name in OWN
            axis.plot(list(one["dice"]), list(one["dice"].values()), marker="os^Dv<>"[i % 7], label=name,
                      color=COLOURS[i % 6], linewidth=2.5 if own else 1.2, linestyle="-" if i < 6 else "--")
        axis.set_xscale("log")
        axis.set_xticks(BUDGETS, [str(n) for n in BUDGETS])
        axis.minorticks_off()
        axis.set_xlabel("clicks")
        axis.set_title(f"{TITLES[half].lower()}, {len(chosen(half))} objects", fontsize=10)
        axis.grid(True, alpha=0.3)
    axes[0][0].set_ylabel("Dice, median")
    axes[0][-1].legend(fontsize=8)
    figure.tight_layout()
    path = folder / "clicks.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return [path]
