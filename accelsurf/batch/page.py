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
#: What stands above the numbers of a case, in this order.
_HEADS = {
    "quality": "likely good", "ml": "ml", "dice": "Dice", "objects": "objects", "frames": "frames", "seconds": "seconds"
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
        Of the table in CSV; the page has those of them that it has a heading for.
    """
    counts = {key: sum(one.status == key for one in outcomes) for key in ("ok", "failed", "waiting")}
    summary = ", ".join(f"{number} {key}" for key, number in counts.items() if number) or "no case"
    ended = [one for one in sorted(outcomes, key=doubt) if one.status != "waiting"]
    links = " ".join(f'<a href="{quote(name)}">{escape(name)}</a>' for name in files)
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"><title>accelsurf batch</title>',
        f"<style>{_STYLE}</style></head><body>",
        f"<h1>{len(outcomes)} cases: {summary}</h1>",
        f"<p>{escape(status)}; the most doubtful first. {links}</p>",
        *_table(ended, columns),
        *(line for number, one in enumerate(ended) for line in _section(number, one)),
        "</body></html>",
    ]
    return "\n".join(lines) + "\n"


def doubt(outcome: Outcome) -> tuple[int, float, str]:
    """Order of the cases: failed, without a quality, by falling doubt, those that wait.

    Examples
    --------
    >>> good, bad = Outcome("a", "ok", quality=0.9), Outcome("b", "ok", quality=0.2)
    >>> [one.id for one in sorted([Outcome("d"), good, bad, Outcome("c", "failed")], key=doubt)]
    ['c', 'b', 'a', 'd']
    """
    first = {"failed": 0, "ok": 1, "waiting": 2}[outcome.status]
    return first, -1.0 if outcome.quality is None else outcome.quality, outcome.id


def _table(outcomes: Sequence[Outcome], columns: Sequence[str]) -> list[str]:
    numbers = [name for name in _HEADS if name in columns]
    heads = "".join(f"<th>{_HEADS[name]}</th>" for name in numbers)
    lines = ["<table>", f"<tr><th>case</th>{heads}<th class=text>end</th></tr>"]
    for number, one in enumerate(outcomes):
        name = f'<a href="#case{number}">{escape(one.id)}</a>'
        kind = ' class="failed"' if one.status == "failed" else ""
        values = {key: getattr(one, key) for key in numbers}
        cells = (_percent(value) if key == "quality" else _number(value) for key, value in values.items())
        line = "".join(f"<td>{cell}</td>" for cell in (name, *cells))
        lines.append(f'<tr{kind}>{line}<td class=text>{escape(one.reason)}</td></tr>')
    return [*lines, "</table>"]


def _section(number: int, one: Outcome) -> list[str]:
    head = f'<section id="case{number}"><h2>{escape(one.id)}</h2>'
    texts = [f"<p>{_summary(one)}</p>"]
    if one.status == "failed":
        texts = [f'<p class="failed">{escape(one.reason)}</p>', f"<p>{escape(one.hint)}</p>" if one.hint else ""]
    texts += [f"<p>{escape(warning)}</p>" for warning in one.warnings]
    picture = ""
    if one.picture:
        place = quote(f"{one.folder}/{one.picture}")
        picture = f'<a href="{quote(one.folder)}/"><img loading="lazy" alt="{escape(one.id)}" src="{place}"></a>'
    return [head, *(text for text in texts if text), *([picture] if picture else []), "</section>"]


def _summary(one: Outcome) -> str:
    """What is known of a result, in a line."""
    parts = [
        f"{_percent(one.quality)} likely to be good" if one.quality is not None else "",
        f"{_number(one.ml)} ml" if one.ml is not None else "",
        f"Dice {_number(one.dice)}" if one.dice is not None else "",
        f"{one.objects} object{'' if one.objects == 1 else 's'} in {one.frames} frames" if one.frames else "",
        escape(one.reason),
    ]
    return ", ".join(part for part in parts if part)


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.0%}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
