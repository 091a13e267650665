"""Record of the quality of a result, as reports, tables and viewers have it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from accelsurf.clicks.model import Answer


class PlateauNote(NamedTuple):
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
    next_doubt : float
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
    level_overlap, size_spread, correction, kept, taken, surprise : float or None
        How sure the model of the clicks is: ``overlap``, ``spread``, ``correction``, ``kept``, ``taken`` and
        ``surprise`` of
        `accelsurf.clicks.model.confidence.Confidence`; None without one.
    unlike_learned : float or None
        Share of the object, without the voxels next to its surface, whose values lie further than 2.5 standard
        deviations from the mean of those that it was learned from; None where no model was learned once.
    leaked : bool
        Whether it grew beyond ``max_volume``.
    rests : tuple of PlateauNote
        Plateaus of the front before it broke through.
    warnings : tuple of str
        What is uncertain, each with a command to try next.
    notes : tuple of str
        Remarks worth knowing and mostly harmless.
    answers : tuple of Answer
        To the first click: the one that was taken, and others that are likely; none without a model of clicks.
    """

    probability: float
    next_click: tuple[float, float, float] | None
    next_doubt: float
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
    kept: float | None
    taken: float | None
    surprise: float | None
    unlike_learned: float | None
    leaked: bool
    rests: tuple[PlateauNote, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    answers: tuple[Answer, ...] = ()
