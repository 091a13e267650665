"""Record of the quality of a result, the probability that it is good, and the measure that speaks most against it.

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
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from accelsurf.clicks import Answer

#: Radius of a correction (object's radii), Dice of the objects before and after it, and how sure the model was of the
#: opposite, where no click has corrected a result.
USUAL = {"correction": 0.37, "unchanged": 0.77, "disagreement": 0.3}
#: Largest probability of an ambiguous result: no measure of it tells which object was meant.
UNSURE = 0.45
#: The file with the models of the probability.
MODEL_FILE = "good_result.json"
#: Names of the models.
ModelKind = Literal["clicks", "image"]


class Plateau(NamedTuple):
    """A plateau of the front: its ``step``, its ``volume_mm3`` then, and the ``place`` (x, y, z; mm, LPS) near which
    the front broke through at step ``left_at``.
    """

    step: int
    volume_mm3: float
    left_at: int
    place: tuple[float, float, float]


class Quality(NamedTuple):
    """Measures of a result that need no reference.

    Attributes
    ----------
    probability : float
        That the result is good (a Dice of 0.8 or more), by a logistic model of the measures below; how it was
        calibrated stands in docs/explanation/quality.md.
    next_click : (x, y, z) or None
        World mm (LPS): the most uncertain place, where to click next.
    next_uncertainty : float
        Uncertainty there, 0 to 1.
    rim_fraction : float
        Share of the object's voxels that lie next to its surface.
    border_fraction : float
        Share of the object's surface that lies on the volume's border.
    contrast : float
        Median difference of the image across the surface, in units of how much it differs within the object over the
        same distance.
    no_edge_fraction : float
        Share of the surface where the image has no edge: a gradient within the lower three quarters of those inside the
        object.
    evidence : float
        Mean evidence of the image for the surface, 0 to 1: an edge, and beyond it values unlike the object's.
    clicked : float
        Mean evidence of clicks: 1 where all of the surface lies beside one.
    beyond_clicks : float or None
        Volume of the object over that of the clicked voxels in it; None without clicks.
    inside_like : float
        Share of the surface beyond which the image has values of the object.
    drift : float
        Difference of the object's values between shells around its middle, in units of their deviation.
    compactness : float
        36 pi V^2/A^3, 1 for a ball; in one slice 4 pi A/L^2.
    parts_beyond_necks : int
        Large parts that remain when necks of less than four voxels are removed; 1 for a compact object.
    growth : float
        Volume at the end over that of the start.
    late_growth : float
        Relative change of the volume over the last 20 steps.
    level_overlap, size_spread, correction, unchanged, taken, disagreement : float or None
        How sure the model of the clicks is: ``overlap``, ``spread``, ``correction``, ``unchanged``, ``taken`` and
        ``disagreement`` of `accelsurf.clicks.model.confidence.Confidence`; None without one.
    unlike_learned : float or None
        Share of the object, without the voxels next to its surface, whose values lie further than 2.5 standard
        deviations from the mean of those that it was learned from; None where no model was learned once.
    leaked : bool
        Whether it grew beyond ``max_volume``.
    plateaus : tuple of Plateau
        Plateaus of the front before it broke through.
    warnings : tuple of str
        Reasons for uncertainty, each with a command to try next.
    notes : tuple of str
        Remarks worth knowing and mostly harmless.
    answers : tuple of Answer
        To the first click: the one that was taken, and others that are likely; none without a model of clicks, and
        where a click has corrected it.
    is_ambiguous : bool
        The clicks may mean an object of quite another size: the probability is at most `UNSURE`.
    is_corrected : bool
        Clicks have corrected the surface: the probability is at most the least before.
    """

    probability: float
    next_click: tuple[float, float, float] | None
    next_uncertainty: float
    rim_fraction: float
    border_fraction: float
    contrast: float
    no_edge_fraction: float
    evidence: float
    clicked: float
    beyond_clicks: float | None
    inside_like: float
    drift: float
    compactness: float
    parts_beyond_necks: int
    growth: float
    late_growth: float
    level_overlap: float | None
    size_spread: float | None
    correction: float | None
    unchanged: float | None
    taken: float | None
    disagreement: float | None
    unlike_learned: float | None
    leaked: bool
    plateaus: tuple[Plateau, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    answers: tuple[Answer, ...] = ()
    is_ambiguous: bool = False
    is_corrected: bool = False

    @property
    def likely(self) -> str:
        """The probability in words: a lower bound once a click has corrected the result."""
        bound = "at least " if is_lower_bound(self) else ""
        return f"{bound}{self.probability:.0%} likely to be good"


def model_kind(found: Quality) -> ModelKind:
    """Return the model that tells the probability."""
    return "image" if found.level_overlap is None else "clicks"


def features(found: Quality) -> dict[str, float]:
    """Return the features of the probability, by name."""
    return click_features(found) or image_features(found)


def click_features(found: Quality) -> dict[str, float] | None:
    """Return the features of the model of the clicks; None without one.

    No measure of a click is among them, neither how many there were, nor how small the last one was, nor how little it
    changed: a person who clicks anywhere would raise the probability of the same surface. Nor is the compactness, which
    tells of objects and not of this result.
    """
    if found.level_overlap is None or found.size_spread is None:
        return None
    return {
        "level_overlap": _log_odds(found.level_overlap),
        "size_spread": min(found.size_spread, 3.0),
        "rim": found.rim_fraction,
        "drift": _drift(found),
    }


def history_features(found: Quality) -> dict[str, float]:
    """Return measures of the last corrections, by name; the usual ones where none was made.

    The calibration holds them fast, and counts them as the usual ones: see `benchmarks/quality.py`.
    """
    correction = USUAL["correction"] if found.correction is None else found.correction
    unchanged = USUAL["unchanged"] if found.unchanged is None else found.unchanged
    return {
        "correction": math.log(min(max(correction, 0.03), 5.0)),
        "unchanged": _log_odds(unchanged),
        "surprise": USUAL["disagreement"] if found.disagreement is None else found.disagreement,
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
        "level_overlap": "a small change of its size gives another shape",
        "size_spread": "objects of other sizes fit the clicks as well",
        "rim": f"it is thin or small: {found.rim_fraction:.0%} of its voxels lie at its surface",
        "drift": f"its grey values change from its centre outwards, by {found.drift:.1f} standard deviations",
        "no_edge": f"{found.no_edge_fraction:.0%} of its surface lies where the image has no edge",
    }
    return words[lowest_term(model_kind(found), features(found), words)]


@functools.cache
def calibrated_models() -> dict[str, dict[str, Any]]:
    """Return the models by kind: ``features`` (name: mean, deviation, weight), ``constant``, ``threshold``."""
    text = (resources.files("accelsurf.measure") / MODEL_FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def warning_threshold(found: Quality) -> float:
    """Return the probability below which a warning is given.

    Of a corrected result the probability is a lower bound, as no measure of a correction counts: the threshold is the
    stated one at which half of the corrected results are good.
    """
    model = calibrated_models()[model_kind(found)]
    has_own = is_lower_bound(found) and "threshold_corrected" in model
    return float(model["threshold_corrected" if has_own else "threshold"])


def is_lower_bound(found: Quality) -> bool:
    """True where a click has corrected the result: more of these are good than is said."""
    return found.is_corrected or found.correction is not None


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
