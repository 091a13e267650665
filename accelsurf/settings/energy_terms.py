"""The terms that an energy can have: one entry each. Everything that lists or checks terms reads the entries.

An entry has the settings of the term with their bounds, and the settings of the run that it uses. The functions that
make the terms are in `accelsurf.run.makers`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from accelsurf.settings.expression import HALF, Number, Spec, Values, Word
from accelsurf.settings.registry import by_name


@dataclass(frozen=True)
class TermSpec(Spec):
    """The entry of a term.

    Attributes
    ----------
    uses_to_learn : tuple of str
        Settings of the run that it uses only when it ``learns``.
    sees_image : bool
        Whether it depends on the image. An energy needs one term that does.
    channels : {"first", "mean", "sum"}
        Of an image of several channels: it sees the first, or is the mean or the sum over all of them.
    signed : bool
        Whether its weight may be negative.
    example : str or None
        How lists of energies show it; None if they do not.
    keeps_fine_edges : bool
        Whether it needs edges that coarser grids do not show: ``levels = "auto"`` is then the image's own grid alone.
    learns : callable
        Of the settings: whether it learns once from the start, unless it is given something else to learn from.
    uses_model : bool
        True if it uses the model of the clicks, which then gives the start, too.
    needs_whole : bool
        Whether it looks at all of the image, beyond the voxels near the surface and the numbers of `WholeImage`.
    """

    uses_to_learn: tuple[str, ...] = ()
    sees_image: bool = True
    channels: Literal["first", "mean", "sum"] = "first"
    signed: bool = False
    example: str | None = None
    keeps_fine_edges: bool = False
    learns: Callable[[Values], bool] = lambda settings: False
    uses_model: bool = False
    needs_whole: bool = False

    def is_used(self, key: str, settings: Values) -> bool:
        """Return True if a setting of the run acts on the term with these settings of its own."""
        return key in self.uses or (key in self.uses_to_learn and self.learns(settings))


def _thresholds_expected(settings: Values) -> str:
    low, high = settings.get("LO", ""), settings.get("HI", "")
    if low == "" and high == "":
        return "at least one bound: threshold:LO,HI, threshold:LO, or threshold:,HI"
    if isinstance(low, float) and isinstance(high, float) and not low < high:
        return "a low threshold below the high one"
    if low == "auto" and high == "auto":
        return "auto for one of the two thresholds"
    return ""


def _has_learned_bound(settings: Values) -> bool:
    words = [value for value in settings.values() if isinstance(value, str)]
    return any(word == "learned" or word.startswith(HALF) for word in words)


_POSITIVE = Number(0.0, low_too=False)
_CHANNEL = Number(1.0, help="the one channel that the term sees, counted from 1")
_EPSILON = Number(0.0, 2.5, help="half width of the smeared interface, voxels")
#: In the image's unit, a percentile, Otsu's threshold, learned from the start's values, half-way between their mean
#: and a value, or open.
_BOUND = Number(words=("auto", "learned", ""), percent=True)

TERMS: dict[str, TermSpec] = by_name(
    TermSpec(
        "chan-vese",
        "two regions, each with its own mean",
        {
            "balance": _POSITIVE._replace(help="weight of the fit inside against the fit outside"),
            "epsilon": _EPSILON,
            "channel": _CHANNEL,
            "area": Number(
                0.0,
                help="weight of the area beside --smoothness, mm; by the image's noise unless given",
            ),
        },
        uses=("balance", "epsilon"),
        channels="mean",
        example="chan-vese",
    ),
    TermSpec(
        "local-region",
        "two regions, each with its mean within R mm of each place",
        {
            "R": _POSITIVE._replace(
                help="radius of the window, mm; 8 voxels of the largest spacing unless given"
            ),
            "epsilon": _EPSILON,
            "channel": _CHANNEL,
        },
        uses=("epsilon",),
        channels="mean",
        example="local-region",
        needs_whole=True,
    ),
    TermSpec(
        "likelihood",
        "two regions by the distributions of their values",
        {
            "model": Word(
                ("gauss", "histogram"), "the distribution: Gaussians, or smoothed histograms"
            ),
            "update": Word(
                ("yes", "no"), "learned from the surface in each step, or once from the start"
            ),
            "epsilon": _EPSILON._replace(
                help="half width of the smeared interface, voxels; 0 unless given"
            ),
            "channel": _CHANNEL,
        },
        uses=("foreground", "background"),
        channels="sum",
        example="likelihood",
        learns=lambda settings: settings.get("update") == "no",
    ),
    TermSpec(
        "threshold",
        "a window of values from LO to HI",
        {
            "LO": _BOUND._replace(help="lower bound, in the image's unit"),
            "HI": _BOUND._replace(help="upper bound, in the image's unit"),
            "soft": _POSITIVE._replace(
                help="width over which a bound sets in, in the image's unit"
            ),
            "channel": _CHANNEL,
        },
        uses_to_learn=("foreground",),
        example="threshold:auto",
        check=_thresholds_expected,
        learns=_has_learned_bound,
    ),
    TermSpec(
        "geodesic",
        "the area, counted less on edges",
        {
            "scale": _POSITIVE._replace(help="sigma of the Gaussian gradient, mm"),
            "contrast": _POSITIVE._replace(
                help="gradient that counts as half an edge, parts of the range per mm"
            ),
            "balloon": Number(help="pressure away from edges, per mm; above 0 the surface shrinks"),
            "channel": _CHANNEL,
        },
        uses=("edge_scale", "edge_contrast", "balloon"),
        example="geodesic",
        keeps_fine_edges=True,
        needs_whole=True,
    ),
    TermSpec(
        "balloon",
        "the volume, so that the surface shrinks; with a weight below 0 it grows",
        sees_image=False,
        signed=True,
    ),
    TermSpec(
        "seeded",
        "what small networks read from the image around the clicks; needs --inside",
        {
            "area": Number(
                0.0, help="weight of the area beside --smoothness, mm; of the model unless given"
            )
        },
        uses=("size", "answer"),
        example="seeded",
        uses_model=True,
    ),
    TermSpec(
        "partition",
        "what is nearer to the object's own clicks than to those of the others, where what looks different is far: "
        "cells between membranes, nuclei; needs clicks in each of them",
        {
            "area": Number(
                0.0, help="weight of the area beside --smoothness, mm; of the model unless given"
            )
        },
        uses_model=True,
        needs_whole=True,
    ),
    TermSpec(
        "area",
        "the surface's area; its weight is in mm, as --smoothness",
        sees_image=False,
    ),
)


def image_terms() -> tuple[str, ...]:
    """Names of the terms that depend on the image; the others need one of them beside."""
    return tuple(name for name, spec in TERMS.items() if spec.sees_image)


def examples() -> tuple[str, ...]:
    """Energies for lists to choose from: one of each kind that needs no further input."""
    return tuple(spec.example for spec in TERMS.values() if spec.example is not None)
