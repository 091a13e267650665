"""Probability that a result is good, by its measures of quality, and what speaks most against it.

The probability is a logistic model of a few measures, calibrated by ``scripts/study quality``. There are two:
``clicks`` for a result whose model of clicks says how sure it is, and ``image`` for all others. The study writes them
into the file beside this one: for each feature its mean, standard deviation and weight; the constant term; and the
probability below which a warning is given.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Collection, Mapping
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from accelsurf.measure.records import Quality

#: What counts where no click has corrected a result: radius of a correction (object's radii), what it keeps (Dice), and
#: how sure the model was of the opposite.
USUAL_CORRECTION, USUAL_KEPT, USUAL_SURPRISE = 0.37, 0.77, 0.3
#: The file with the models of the probability.
MODEL_FILE = "good_result.json"
#: Names of the models.
ModelKind = Literal["clicks", "image"]


def model_kind(found: Quality) -> ModelKind:
    """Return the model that tells the probability."""
    return "image" if found.level_overlap is None else "clicks"


def features(found: Quality) -> dict[str, float]:
    """Return the features of the probability, by name."""
    return click_features(found) or image_features(found)


def click_features(found: Quality) -> dict[str, float] | None:
    """Return the features of the model of the clicks; None without one.

    Neither the number of clicks nor the compactness is among them: they tell of objects, not of this result.
    """
    if found.level_overlap is None or found.size_spread is None:
        return None
    correction = USUAL_CORRECTION if found.correction is None else found.correction
    return {
        "level_overlap": _log_odds(found.level_overlap),
        "size_spread": min(found.size_spread, 3.0),
        "correction": math.log(min(max(correction, 0.03), 5.0)),
        "kept": _log_odds(USUAL_KEPT if found.kept is None else found.kept),
        "surprise": USUAL_SURPRISE if found.surprise is None else found.surprise,
        "rim": found.rim_fraction,
        "drift": _drift(found),
    }


def image_features(found: Quality) -> dict[str, float]:
    """Return the features of surface and image, whatever made the result."""
    return {"rim": found.rim_fraction, "drift": _drift(found), "no_edge": found.no_edge_fraction}


def _drift(found: Quality) -> float:
    return math.log1p(min(found.drift, 20.0))


def _log_odds(share: float) -> float:
    share = min(max(share, 0.01), 0.99)
    return math.log(share / (1.0 - share))


def why(found: Quality) -> str:
    """The measure that speaks most against it, in words."""
    words = {
        "level_overlap": "slightly more or less would be another object",
        "size_spread": "other sizes are likely too",
        "rim": f"it is thin or small: {found.rim_fraction:.0%} of its voxels lie at its surface",
        "drift": f"its values change from its middle outwards, by {found.drift:.1f} deviations",
        "no_edge": f"under {found.no_edge_fraction:.0%} of the surface the image has no edge",
    }
    if found.correction is not None and found.kept is not None:
        words["correction"] = f"the last click was a large one, {found.correction:.2g} radii of the object"
        words["kept"] = f"the last click changed much of it: of before it keeps a Dice of {found.kept:.2f}"
        words["surprise"] = "clicks were needed where it had been sure of the opposite"
    return words[lowest_term(model_kind(found), features(found), words)]


@functools.cache
def calibrated_models() -> dict[str, dict[str, Any]]:
    """Return the models by kind: ``features`` (name: mean, deviation, weight), ``constant``, ``threshold``."""
    text = (resources.files("accelsurf.measure") / MODEL_FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def warning_threshold(kind: ModelKind) -> float:
    """Return the probability below which a warning is given."""
    return float(calibrated_models()[kind]["threshold"])


def probability_good(kind: ModelKind, features: Mapping[str, float]) -> float:
    """Return the probability that a result with these features is good, 0 to 1."""
    total = float(calibrated_models()[kind]["constant"]) + sum(_terms(kind, features).values())
    return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


def lowest_term(kind: ModelKind, features: Mapping[str, float], names: Collection[str]) -> str:
    """Return which of the features that are named lowers the probability most."""
    terms = _terms(kind, features)
    return min((name for name in terms if name in names), key=terms.__getitem__)


def _terms(kind: ModelKind, features: Mapping[str, float]) -> dict[str, float]:
    return {
        name: weight * (features[name] - mean) / deviation
        for name, (mean, deviation, weight) in calibrated_models()[kind]["features"].items()
    }
