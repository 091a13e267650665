"""The page of a batch: every picture on one page, the most doubtful first. One file of HTML, without a script."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from urllib.parse import quote

from accelsurf.batch.outcome import COLUMNS, Outcome

_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2em; color: #222; background: #fff; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { padding: .2em .8em; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child, .text { text-align: left; }
section { border-top: 1px solid #ccc; padding: .5em 0 1em; }
h2 { font-size: 1.1em; margin: .4em 0; }
img { max-width: 100%; height: auto; }
.failed { color: #a00; }
"""
#: Headings of the numbers of a case, in this order.
_HEADS = {
    "probability": "likely to be good",
    "ml": "ml",
    "dice": "Dice",
    "objects": "objects",
    "frames": "frames",
    "seconds": "seconds",
}


def page_html(
    outcomes: Sequence[Outcome], status: str, files: Sequence[str], columns: Sequence[str] = COLUMNS
) -> str:
    """Return the page.

    Failed cases come first, then the others by the probability that they are good, the least first.

    Parameters
    ----------
    outcomes : sequence of Outcome
    status : str
        Of the batch.
    files : sequence of str
        Names of the tables beside it.
    columns : sequence of str, optional
        Of the table in CSV; the page has the columns that it has a heading for.
    """
    counts = {
        key: sum(outcome.status == key for outcome in outcomes)
        for key in ("ok", "failed", "waiting")
    }
    summary = ", ".join(f"{number} {key}" for key, number in counts.items() if number) or "no case"
    ended = [
        outcome for outcome in sorted(outcomes, key=by_uncertainty) if outcome.status != "waiting"
    ]
    links = " ".join(f'<a href="{quote(name)}">{escape(name)}</a>' for name in files)
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"><title>accelsurf batch</title>',
        f"<style>{_STYLE}</style></head><body>",
        f"<h1>{len(outcomes)} cases: {summary}</h1>",
        f"<p>{escape(status)}; the most doubtful first. {links}</p>",
        *_table(ended, columns),
        *(line for number, outcome in enumerate(ended) for line in _section(number, outcome)),
        "</body></html>",
    ]
    return "\n".join(lines) + "\n"


def by_uncertainty(outcome: Outcome) -> tuple[int, float, str]:
    """Order of the cases: failed, without a probability, by falling uncertainty, those that wait.

    Examples
    --------
    >>> good, bad = Outcome("a", "ok", probability=0.9), Outcome("b", "ok", probability=0.2)
    >>> [one.id for one in sorted([Outcome("d"), good, bad, Outcome("c", "failed")], key=by_uncertainty)]
    ['c', 'b', 'a', 'd']
    """
    first = {"failed": 0, "ok": 1, "waiting": 2}[outcome.status]
    return first, -1.0 if outcome.probability is None else outcome.probability, outcome.id


def _table(outcomes: Sequence[Outcome], columns: Sequence[str]) -> list[str]:
    numbers = [name for name in _HEADS if name in columns]
    heads = "".join(f"<th>{_HEADS[name]}</th>" for name in numbers)
    lines = ["<table>", f"<tr><th>case</th>{heads}<th class=text>end</th></tr>"]
    for number, outcome in enumerate(outcomes):
        name = f'<a href="#case{number}">{escape(outcome.id)}</a>'
        kind = ' class="failed"' if outcome.status == "failed" else ""
        values = {key: getattr(outcome, key) for key in numbers}
        cells = (
            _percent(value) if key == "probability" else _number(value)
            for key, value in values.items()
        )
        line = "".join(f"<td>{cell}</td>" for cell in (name, *cells))
        lines.append(f"<tr{kind}>{line}<td class=text>{escape(outcome.reason)}</td></tr>")
    return [*lines, "</table>"]


def _section(number: int, outcome: Outcome) -> list[str]:
    head = f'<section id="case{number}"><h2>{escape(outcome.id)}</h2>'
    texts = [f"<p>{_summary(outcome)}</p>"]
    if outcome.status == "failed":
        hint = f"<p>{escape(outcome.hint)}</p>" if outcome.hint else ""
        texts = [f'<p class="failed">{escape(outcome.reason)}</p>', hint]
    texts += [f"<p>{escape(warning)}</p>" for warning in outcome.warnings]
    if outcome.picture:
        image = f'<img loading="lazy" alt="{escape(outcome.id)}" src="{quote(f"{outcome.folder}/{outcome.picture}")}">'
        texts.append(f'<a href="{quote(outcome.folder)}/">{image}</a>')
    return [head, *(text for text in texts if text), "</section>"]


def _summary(outcome: Outcome) -> str:
    """Return the figures of a result, in a line."""
    count = outcome.objects
    parts = [
        f"{_percent(outcome.probability)} likely to be good"
        if outcome.probability is not None
        else "",
        f"{_number(outcome.ml)} ml" if outcome.ml is not None else "",
        f"Dice {_number(outcome.dice)}" if outcome.dice is not None else "",
        f"{count} object{'' if count == 1 else 's'} in {outcome.frames} frames"
        if outcome.frames
        else "",
        escape(outcome.reason),
    ]
    return ", ".join(part for part in parts if part)


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.0%}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
