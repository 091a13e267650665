"""The probability that a result is good: a logistic model of a few measures, calibrated by ``scripts/study quality``.

There are two: ``clicks`` for a result whose model of clicks says how sure it is, and ``image`` for all others. The
study writes them into the file beside this one: of each feature the mean and the deviation that it is put on scale by,
and its weight; the weight of none; and the probability below which a warning is given.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Collection, Mapping
from importlib import resources
from typing import Any, Literal

#: The file with the models.
FILE = "good_result.json"
#: Their names.
Kind = Literal["clicks", "image"]


@functools.cache
def models() -> dict[str, dict[str, Any]]:
    """Return the models by kind: ``features`` (name: mean, deviation, weight), ``constant``, ``threshold``."""
    text = (resources.files("accelsurf.analysis") / FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def threshold(kind: Kind) -> float:
    """Return the probability below which a warning is given."""
    return float(models()[kind]["threshold"])


def probability(kind: Kind, features: Mapping[str, float]) -> float:
    """Return the probability that a result with these features is good, 0 to 1."""
    total = float(models()[kind]["constant"]) + sum(_terms(kind, features).values())
    return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


def lowest_term(kind: Kind, features: Mapping[str, float], names: Collection[str]) -> str:
    """Return which of the features that are named lowers the probability most."""
    terms = _terms(kind, features)
    return min((name for name in terms if name in names), key=terms.__getitem__)


def _terms(kind: Kind, features: Mapping[str, float]) -> dict[str, float]:
    return {
        name: weight * (features[name] - mean) / deviation
        for name, (mean, deviation, weight) in models()[kind]["features"].items()
    }
