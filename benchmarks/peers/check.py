"""What fell since the kept results: ratios of programs that ran in turns, so that the machine's speed cancels."""

from __future__ import annotations

from typing import Any, NamedTuple

#: A ratio that is worse by this part of its former value fell.
FALL = 0.1


class Change(NamedTuple):
    """The ratio of a pair in the kept result and now."""

    pair: str
    before: float
    now: float
    fell: bool

    def __str__(self) -> str:
        """One line: the pair, both ratios, whether it fell."""
        return f"{self.pair}: {self.before:.3g} -> {self.now:.3g}{', FELL' if self.fell else ''}"


def changes(kept: dict[str, Any], now: dict[str, Any]) -> list[Change]:
    """Compare the pairs that both results have.

    Parameters
    ----------
    kept, now : dict
        As `benchmarks.benchmark.run` writes them. The ratio of a pair should be large, or with ``sense`` "<=" small.

    Examples
    --------
    >>> kept = {"pairs": [{"pair": "peer / own", "ratio": 10.0}, {"pair": "own / copy", "ratio": 2.0}]}
    >>> now = {"pairs": [{"pair": "peer / own", "ratio": 8.9}, {"pair": "own / copy", "ratio": 2.1, "sense": "<="}]}
    >>> [str(change) for change in changes(kept, now)]
    ['peer / own: 10 -> 8.9, FELL', 'own / copy: 2 -> 2.1']
    """
    before = {pair["pair"]: float(pair["ratio"]) for pair in kept["pairs"]}
    found = []
    for pair in now["pairs"]:
        if pair["pair"] not in before:
            continue
        old, new = before[pair["pair"]], float(pair["ratio"])
        worse = new > (1.0 + FALL) * old if pair.get("sense") == "<=" else new < (1.0 - FALL) * old
        found.append(Change(pair["pair"], old, new, worse))
    return found
