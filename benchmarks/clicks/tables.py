"""What the games come to: JSON of all figures, tables in Markdown for the docs, a picture."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.clicks.folds import FAMILIES, NAMES, PHANTOMS
from benchmarks.clicks.games import (
    BUDGETS,
    FAILED,
    GOOD,
    LEVELS,
    SAID,
    challenge,
    clicks_to,
    dice_after,
    summary,
    variants,
)
from benchmarks.clicks.methods import METHODS, OWN
from benchmarks.clicks.objects import ClickObject, selected
from benchmarks.clicks.store import Store, key_of
from benchmarks.figures.common import COLOURS, plain
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import goal, machine
from benchmarks.peers.render import measured, verdict

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "explanation" / "click-benchmark.md"
#: Kinds of games, and how the tables call them.
KINDS = {
    "plain": "exact clicks",
    "answers": "exact clicks; another answer in place of the second click where that is better",
    "size": "exact clicks, and a size 25 % too large or 20 % too small",
    "jitter": "jittered clicks, five seeds",
    "box": "first a box and a click in it",
    "stroke": "first a stroke",
}
CHALLENGES = {"cvpr": "first a point", "cvpr-box": "first a box and a point in it"}
#: Goals: medians of the Dice over the scans' folds after so many exact clicks; of each fold after five.
WANTED, WANTED_IN_FOLD = {1: 0.68, 2: 0.79, 3: 0.83, 5: 0.87, 10: 0.90}, 0.75
#: What a row is of in which the person has selected among up to three answers to the first click.
BEST_OF_ANSWERS = "best of its answers (one more decision of the person)"
Games = Mapping[str, Mapping[str, dict[str, Any]]]


def write(folder: Path, page: Path | None) -> list[Path]:
    """Write JSON, tables and picture beside the games, and the tables into a page of the docs too; return the files."""
    games = {kind: collected(folder, kind) for kind in (*KINDS, *CHALLENGES)}
    settings = settings_of(folder)
    figures = {kind: figures_of(games[kind]) for kind in KINDS if games[kind]}
    fields = {
        kind: {
            name: challenge(list(of_scans(played).values())) for name, played in games[kind].items()
        }
        for kind in CHALLENGES
        if games[kind]
    }
    goals = goals_of(figures.get("plain", {}))
    results = plain(
        {
            "machine": machine(),
            "settings": settings,
            "goals": goals,
            "figures": figures,
            "challenge": fields,
        }
    )
    target = folder / "clicks.json"
    target.write_text(json.dumps(results, indent=1) + "\n")
    text = text_of(figures, fields, games["plain"], goals, settings)
    tables = folder / "clicks.md"
    tables.write_text(text)
    if page is not None:
        put_table(page, "clicks", text, "scripts/benchmark")
    return [target, tables, *([page] if page is not None else []), *picture(folder, figures)]


def settings_of(folder: Path) -> dict[str, dict[str, tuple[dict[str, Any], bool]]]:
    """Method -> fold -> settings that its games have there, and whether they were selected on the other folds."""
    out: dict[str, dict[str, tuple[dict[str, Any], bool]]] = {}
    for name, method in METHODS.items():
        store = Store(folder, name)
        out[name] = {}
        for fold in NAMES:
            found = method.settings(store, fold)
            out[name][fold] = (method.default, False) if found is None else (found, True)
    return out


def collected(folder: Path, kind: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Method -> object and variant -> game, of the methods that played all objects of the scans' folds."""
    asked = {
        f"{which.name} {variant}"
        for which in selected()
        if which.fold != PHANTOMS
        for variant in variants([kind])
    }
    return {name: games for name, games in every_game(folder, kind).items() if asked <= set(games)}


def every_game(folder: Path, kind: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Method -> object and variant -> game, as far as they were played with the settings of the fold."""
    out: dict[str, dict[str, dict[str, Any]]] = {}
    settings = settings_of(folder)
    for name in METHODS:
        store = Store(folder, name)
        keys = {
            f"{which.name} {variant}": key_of(which.name, variant, settings[name][which.fold][0])
            for which in selected()
            for variant in variants([kind])
        }
        out[name] = {
            shown: game for shown, key in keys.items() if (game := store.played(key)) is not None
        }
    return out


def of_objects(
    games: Mapping[str, dict[str, Any]], fits: Callable[[ClickObject], bool]
) -> dict[str, dict[str, Any]]:
    """Games of the objects that fit."""
    names = {which.name for which in selected() if fits(which)}
    return {key: game for key, game in games.items() if key.split()[0] in names}


def of_scans(games: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Games of all objects but phantoms."""
    return of_objects(games, lambda which: which.fold != PHANTOMS)


def figures_of(games: Games) -> dict[str, Any]:
    """Figures of each method: of all scans, by fold, by family (of scans)."""
    out = {}
    for name, played in games.items():
        parts = {
            "all": of_scans(played),
            **{
                f"fold {fold}": of_objects(played, lambda which, fold=fold: which.fold == fold)
                for fold in NAMES
            },
            **{
                family: of_objects(
                    of_scans(played), lambda which, family=family: which.family == family
                )
                for family in FAMILIES
            },
        }
        out[name] = {part: summary(list(held.values())) for part, held in parts.items() if held}
    return out


def goals_of(methods: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Goals of the exact games over the scans' folds, and what was measured."""
    ours = methods.get("accelsurf", {})
    every = ours.get("all", {})
    peers = {name: found["all"] for name, found in methods.items() if name not in OWN}
    dice = every.get("dice", {})
    folds = [
        found["dice"][5]
        for part, found in ours.items()
        if part.startswith("fold") and part != f"fold {PHANTOMS}" and 5 in found["dice"]
    ]
    goals = [
        *(
            goal(f"median Dice after {_count(n)}", level, dice.get(n), ">=", "")
            for n, level in WANTED.items()
        ),
        goal(
            "lowest fold's median Dice after 5 clicks",
            WANTED_IN_FOLD,
            min(folds, default=None),
            ">=",
            "",
        ),
        goal("median number of clicks to .85", 4, every.get("noc", {}).get(0.85), "<=", ""),
        goal("objects at .85 within five clicks", 0.65, every.get("within5"), ">=", ""),
        goal(
            "clicks after which the Dice fell by more than .02", 0.02, every.get("fell"), "<=", ""
        ),
        goal(
            "results said to be good that are",
            0.85,
            every.get("confidence", {}).get("good_of_said"),
            ">=",
            "",
        ),
        goal(
            "failed results said to be good",
            0.05,
            every.get("confidence", {}).get("said_of_failed"),
            "<=",
            "",
        ),
    ]
    for n in BUDGETS:
        best = max(
            (found["dice"][n] for found in peers.values() if n in found["dice"]), default=None
        )
        if best is not None:
            goals.append(
                goal(
                    f"median Dice after {_count(n)}, as the best peer's",
                    best,
                    dice.get(n),
                    ">=",
                    "",
                )
            )
    return goals


def _count(clicks: int) -> str:
    return "one click" if clicks == 1 else f"{clicks} clicks"


def text_of(
    figures: Mapping[str, Any],
    fields: Mapping[str, Any],
    exact: Games,
    goals: Sequence[dict[str, Any]],
    settings: Mapping[str, Mapping[str, tuple[dict[str, Any], bool]]],
) -> str:
    """All tables in Markdown."""
    lines = [
        "## Goals, over the folds of scans",
        "",
        *head_of(("goal", "wanted", "measured", "reached")),
    ]
    for each in goals:
        sense = "at most " if each["sense"] == "<=" else "at least "
        lines.append(
            row_of((each["what"], sense + measured(each, "wanted"), measured(each), verdict(each)))
        )
    for kind, methods in figures.items():
        every = {name: found["all"] for name, found in methods.items()}
        lines += ["", f"## Scans: {KINDS[kind]}", "", *method_rows(every)]
    if "plain" in figures:
        lines += ["", "## Surfaces: exact clicks", "", *surface_rows(figures["plain"])]
        lines += [
            "",
            "## Probability that the program states",
            "",
            *confidence_rows(figures["plain"]),
        ]
        lines += [
            "",
            "## Each fold: median Dice, exact clicks",
            "",
            *part_rows(figures["plain"], [f"fold {fold}" for fold in NAMES]),
        ]
        lines += [
            "",
            "## Each family: median Dice, exact clicks",
            "",
            *part_rows(figures["plain"], FAMILIES),
        ]
    for kind, methods in fields.items():
        lines += [
            "",
            f"## Protocol of the CVPR 2025 challenge: {CHALLENGES[kind]}",
            "",
            *challenge_rows(methods),
        ]
    if exact:
        lines += ["", "## Each object: exact clicks", "", *object_rows(exact)]
    lines += ["", "## Settings", "", *head_of(("method", "fold left out", "settings"))]
    for name, by_fold in settings.items():
        said: dict[str, list[str]] = {}
        for fold, (held, was_selected) in by_fold.items():
            words = ", ".join(f"{k} {v:g}" for k, v in held.items())
            said.setdefault(words if was_selected else f"{words} (default)", []).append(fold)
        lines += [row_of((name, ", ".join(folds), words)) for words, folds in said.items() if words]
    return "\n".join(lines) + "\n"


def method_rows(methods: Mapping[str, dict[str, Any]]) -> list[str]:
    """A row per method: medians, and means in brackets; one more where a person may choose among answers."""
    head = (
        "method",
        *(f"Dice {n}" for n in BUDGETS),
        *(f"clicks to {level:.2f}" for level in LEVELS),
        "within 5",
        "fell",
        "s first",
        "s later",
        "CPU s",
    )
    lines = head_of(head)
    for name, found in methods.items():
        dice = [
            f"{found['dice'][n]:.3f} ({found['mean'][n]:.3f})" if n in found["dice"] else ""
            for n in BUDGETS
        ]
        noc = [noc_text(found["noc"][level], found["played"]) for level in LEVELS]
        within = "" if found["within5"] is None else f"{found['within5']:.0%}"
        units = "first_wall_s", "later_wall_s", "later_cpu_s"
        times = ["" if found[key] is None else f"{found[key]:.2f}" for key in units]
        lines.append(row_of((name, *dice, *noc, within, f"{found['fell']:.1%}", *times)))
        best = found.get("best_of_answers")
        if best is not None:
            row = f"{name}, {BEST_OF_ANSWERS}", f"{best[0]:.3f} ({best[1]:.3f})"
            lines.append(row_of((*row, *[""] * (len(head) - len(row)))))
    return lines


def surface_rows(methods: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A row per method and number of clicks: surface Dice at one voxel, distances in voxels, medians."""
    lines = head_of(("method", "clicks", "surface Dice", "mean distance", "95 % distance"))
    for name, parts in methods.items():
        for n, found in parts["all"]["surface"].items():
            cells = [_number(found[key]) for key in ("nsd", "mean_voxels", "p95_voxels")]
            lines.append(row_of((name, str(n), *cells)))
    return lines


def confidence_rows(methods: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A row per method that states a probability, for all scans and each fold."""
    lines = head_of(
        (
            "method",
            "objects of",
            "results",
            f"said to be good ({SAID:.0%}): are (Dice {GOOD})",
            f"failed (below {FAILED}): said to be good",
        )
    )
    for name, parts in methods.items():
        for part in ("all", *(f"fold {fold}" for fold in NAMES)):
            found = parts.get(part, {}).get("confidence")
            if found and found["results"]:
                shares = [
                    "-" if share is None else f"{share:.0%}"
                    for share in (found["good_of_said"], found["said_of_failed"])
                ]
                lines.append(row_of((name, part, str(found["results"]), *shares)))
    return lines


def part_rows(methods: Mapping[str, Mapping[str, Any]], parts: Sequence[str]) -> list[str]:
    """A row per fold or family and method: number of objects, and medians of the Dice."""
    lines = head_of(("objects of", "number", "method", *(f"Dice {n}" for n in BUDGETS), "within 5"))
    for part in parts:
        for name, held in methods.items():
            found = held.get(part)
            if found is not None:
                dice = [_number(found["dice"].get(n)) for n in BUDGETS]
                within = "" if found["within5"] is None else f"{found['within5']:.0%}"
                lines.append(row_of((part, str(found["objects"]), name, *dice, within)))
    return lines


def challenge_rows(methods: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A row per method: areas under the curves over the six interactions, and what is reached after the last."""
    lines = head_of(("method", "DSC AUC", "NSD AUC", "DSC final", "NSD final"))
    lines += [
        row_of(
            (
                name,
                *(f"{found[key]:.3f}" for key in ("dsc_auc", "nsd_auc", "dsc_final", "nsd_final")),
            )
        )
        for name, found in methods.items()
    ]
    return lines


def noc_text(clicks: float | None, played: int) -> str:
    """A number of clicks; "20+" where it took more than were played.

    Examples
    --------
    >>> noc_text(2.5, 20), noc_text(21, 20)
    ('2.5', '20+')
    """
    return f"{played}+" if clicks is None or clicks > played else f"{clicks:g}"


def object_rows(methods: Games) -> list[str]:
    """A row per object: ours, and the best peer by the Dice after five clicks."""
    head = (
        "object",
        "fold",
        "family",
        *(f"Dice {n}" for n in BUDGETS),
        "clicks to .85",
        "best peer, Dice 5",
    )
    lines = head_of(head)
    for which in selected():
        key = f"{which.name} plain"
        game = methods.get("accelsurf", {}).get(key)
        peers = {
            name: dice_after(games[key], 5) or 0.0
            for name, games in methods.items()
            if name not in OWN and key in games
        }
        best = max(peers, key=lambda name: peers[name], default="")
        cells = [""] * (len(BUDGETS) + 1)
        if game is not None:
            cells = [
                *(_number(dice_after(game, n)) for n in BUDGETS),
                noc_text(clicks_to(game, 0.85), len(game["clicks"])),
            ]
        if game is not None or best:
            lines.append(
                row_of(
                    (
                        which.name,
                        which.fold,
                        which.family,
                        *cells,
                        f"{peers[best]:.3f} ({best})" if best else "",
                    )
                )
            )
    return lines


def _number(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{value:.3f}"


def flat(folder: Path) -> list[dict[str, Any]]:
    """A row per method and object of exact clicks: fold, family, the course of Dice, probability and seconds."""
    return [
        {
            "method": name,
            "object": which.name,
            "fold": which.fold,
            "family": which.family,
            "dice": [click["dice"] for click in games[key]["clicks"]],
            "sureness": [click.get("sureness") for click in games[key]["clicks"]],
            "cpu_s": [click["cpu_s"] for click in games[key]["clicks"]],
        }
        for name, games in every_game(folder, "plain").items()
        for which in selected()
        if (key := f"{which.name} plain") in games
    ]


def picture(folder: Path, figures: Mapping[str, Any]) -> list[Path]:
    """Draw the median Dice over the number of exact clicks, of scans and of phantoms."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    methods = figures.get("plain", {})
    parts = [
        part
        for part in ("all", f"fold {PHANTOMS}")
        if any(part in found for found in methods.values())
    ]
    if not parts:
        return []
    figure, axes = plt.subplots(
        1, len(parts), figsize=(5.6 * len(parts), 4.4), squeeze=False, sharey=True
    )
    for axis, part in zip(axes[0], parts, strict=True):
        for name, found in methods.items():
            if part not in found:
                continue
            # A method has one colour in all panels.
            i = list(METHODS).index(name)
            is_ours = name in OWN
            dice = found[part]["dice"]
            axis.plot(
                list(dice),
                list(dice.values()),
                marker="os^Dv<>"[i % 7],
                label=name,
                color=COLOURS[i % 6],
                linewidth=2.5 if is_ours else 1.2,
                linestyle="-" if i < 6 else "--",
            )
        axis.set_xscale("log")
        axis.set_xticks(BUDGETS, [str(n) for n in BUDGETS])
        axis.minorticks_off()
        axis.set_xlabel("clicks")
        count = statistics.mode(
            found[part]["objects"] for found in methods.values() if part in found
        )
        axis.set_title(f"{'scans' if part == 'all' else 'phantoms'}, {count} objects", fontsize=10)
        axis.grid(True, alpha=0.3)
    axes[0][0].set_ylabel("Dice, median")
    axes[0][-1].legend(fontsize=8)
    figure.tight_layout()
    path = folder / "clicks.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return [path]
