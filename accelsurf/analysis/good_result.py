"""The probability that a result is good: a logistic model of a few measures, calibrated by ``scripts/study quality``.

The study writes the model into the file beside this one: of each feature the mean and the deviation that it is put on
scale by, and its weight; the weight of none; and the probability below which a warning is given.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

#: The file with the model.
FILE = "good_result.json"


@functools.cache
def model() -> dict[str, Any]:
    """Return the model: ``features`` (name: mean, deviation, weight), ``constant``, ``threshold``."""
    text = (resources.files("accelsurf.analysis") / FILE).read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def threshold() -> float:
    """Return the probability below which a warning is given."""
    return float(model()["threshold"])


def probability(features: Mapping[str, float]) -> float:
    """Return the probability that a result with these features is good, 0 to 1."""
    total = float(model()["constant"]) + sum(_terms(features).values())
    return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


def lowest_term(features: Mapping[str, float]) -> str:
    """Return the name of the feature that lowers the probability most."""
    terms = _terms(features)
    return min(terms, key=terms.__getitem__)


def _terms(features: Mapping[str, float]) -> dict[str, float]:
    return {
        name: weight * (features[name] - mean) / deviation
        for name, (mean, deviation, weight) in model()["features"].items()
    }
