"""Result of a run: an object or several, each with its surface, measures and quality.

An object has the plateaus of its front's speed, where it slowed down before it broke through. The result of a run has
the state from which corrections go on.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.errors import InputError
from accelsurf.evolution import FoundPlateau, LevelSummary, StepRecord, Stop
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import Box
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from accelsurf.image import thumbnail
from accelsurf.image.volume import Volume
from accelsurf.measure import (
    Contours,
    Estimates,
    Intervals,
    Judged,
    Plateau,
    Quality,
    Surface,
    ValueRange,
    assess,
    edge_measures,
    estimates,
    extract_contours,
    extract_surface,
)
from accelsurf.run.ensemble import overall_stop
from accelsurf.run.image_context import ImageContext
from accelsurf.run.preprocessing import PreprocessedInput
from accelsurf.run.setup import EnergyLike
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import size_text

if TYPE_CHECKING:
    from accelsurf.clicks import Confidence

#: Columns of the history that are summed over objects, and columns of which the largest value counts.
_SUMMED = (
    "potential",
    "kinetic",
    "mass_potential",
    "friction_work",
    "smoothing_work",
    "noise_work",
    "mass",
    "volume_mm3",
    "area_mm2",
    "band_cells",
    "cells_visited",
    "seconds",
)
_LARGEST = ("mass_correction", "clamped_fraction", "motion_voxels", "limited_fraction")


@dataclass(frozen=True, eq=False)
class EarlierProbability:
    """The probability of an object before a correction by a click; computed when it is first asked for.

    Attributes
    ----------
    known : float or None
        The probability, where it was asked for already.
    rest : SegmentedObject or None
        Else the object, without arrays of its own.
    inside, clicked : ndarray of uint8, or None
        Its voxels and those that were clicked, as bits.
    """

    known: float | None = None
    rest: SegmentedObject | None = None
    inside: NDArray[np.uint8] | None = None
    clicked: NDArray[np.uint8] | None = None

    @cached_property
    def value(self) -> float:
        """The probability, 0 to 1."""
        if self.rest is None or self.inside is None:
            return 0.0 if self.known is None else self.known
        labels, clicked = (
            None if bits is None else np.unpackbits(bits, count=self.rest.image.size)
            for bits in (self.inside, self.clicked)
        )
        assert labels is not None
        shape = self.rest.image.shape
        return replace(
            self.rest,
            psi=np.where(labels.reshape(shape) > 0, np.float32(-1.0), np.float32(1.0)),
            clicked=None if clicked is None else clicked.reshape(shape) > 0,
        ).quality.probability


def earlier_probability(segmented: SegmentedObject) -> EarlierProbability:
    """Return the probability of an object that a click is about to correct, without computing it now."""
    asked = vars(segmented).get("quality")
    if asked is not None:
        return EarlierProbability(asked.probability)
    clicked = None if segmented.clicked is None else np.packbits(segmented.clicked)
    rest = replace(segmented, psi=np.empty((0, 0, 0), np.float32), clicked=None, plateaus=())
    return EarlierProbability(None, rest, np.packbits(segmented.labels), clicked)


@dataclass(frozen=True, eq=False, repr=False)
class SegmentedObject:
    """One object of a result, on its part of the image's grid: the whole grid for a single object.

    Attributes
    ----------
    id : int
        Its value in the label map.
    box : tuple of slice
        That part of the image's grid.
    psi : ndarray (nz, ny, nx), float32
        Signed distance in the band, mm, negative inside; +-gamma outside it.
    image : ndarray (nz, ny, nx), float32
        The image as the energy saw it.
    geometry : Geometry
    history : list of StepRecord
        One record per step; the last is the final state.
    stop : Stop
        Why it ended.
    terms : list of dict
        The terms of the energy with every setting as it was in the run; empty for an energy of the user's own.
    learned : (float, float) or None
        Lowest and highest value, on the scale of ``image``, that the learned model expects in the object.
    plateaus : tuple of Plateau
        Where its front slowed down before it broke through to something else.
    clicked : ndarray (nz, ny, nx) of bool, or None
        Voxels of its part that a person clicked, on either side.
    confidence : Confidence or None
        Of the model of the clicks in the object; None where the energy has none.
    before : EarlierProbability or None
        The least before its corrections by clicks; None where none was made.
    """

    id: int
    box: Box
    psi: NDArray[np.float32]
    image: NDArray[np.float32]
    geometry: Geometry
    history: list[StepRecord]
    stop: Stop
    terms: list[dict[str, Any]] = field(default_factory=list)
    learned: tuple[float, float] | None = None
    plateaus: tuple[Plateau, ...] = ()
    clicked: NDArray[np.bool_] | None = None
    confidence: Confidence | None = None
    before: EarlierProbability | None = None

    def __repr__(self) -> str:
        volume = size_text(self.volume_mm3, self.geometry.unit, 3)
        return f"SegmentedObject(id={self.id}, {volume}, {self.stop.reason})"

    def _repr_html_(self) -> str:
        """A slice with the outline of the object, and the repr, for notebooks."""
        return thumbnail.as_html(repr(self), self.image, self.geometry, self.labels)

    @cached_property
    def labels(self) -> NDArray[np.uint8]:
        """1 where a voxel's centre is inside, (nz, ny, nx)."""
        return (self.psi < 0).view(np.uint8)

    @property
    def has_surface(self) -> bool:
        """True if something of the grid is inside and something outside."""
        return bool(self.labels.any()) and self.stop.reason not in ("vanished", "filled")

    @cached_property
    def surface(self) -> Surface:
        """The surface as a closed mesh in world mm (LPS), normals outward; extracted once."""
        return extract_surface(self.psi, self.geometry)

    @cached_property
    def contours(self) -> Contours:
        """The contours of an image of one slice, in world mm (LPS), the object on their left; extracted once.

        Raises
        ------
        InputError
            For a volume: it has a `surface`.
        """
        return extract_contours(self.psi, self.geometry)

    @property
    def volume_mm3(self) -> float:
        """Volume within the surface, mm3, sub-voxel; see `estimates` for the object's."""
        return self.history[-1].volume_mm3

    @property
    def area_mm2(self) -> float:
        """Area of the surface, mm2: the mesh's, with the caps where the volume's border cuts the object.

        In an image of one slice: the contour's length times the thickness of the slice.
        """
        if not self.has_surface:
            return 0.0
        if self.length_mm is not None and self._thickness is not None:
            return self.length_mm * self._thickness
        return self.surface.area

    @property
    def length_mm(self) -> float | None:
        """Length of the contours of an image of one slice, mm, with the parts along its border; None for a volume."""
        if self._thickness is None:
            return None
        return self.contours.length if self.has_surface else 0.0

    @property
    def enclosed_mm2(self) -> float | None:
        """Area of the object in an image of one slice, mm2, sub-pixel; None for a volume."""
        return None if self._thickness is None else self.volume_mm3 / self._thickness

    @property
    def _thickness(self) -> float | None:
        axis = self.geometry.slice_axis
        return None if axis is None else self.geometry.spacing[axis]

    @cached_property
    def components(self) -> int:
        """Number of 6-connected parts of the label map."""
        return int(ndimage.label(self.labels)[1])

    @cached_property
    def touches_border(self) -> bool:
        """True if a voxel of the object lies on the border of its grid (axes with one slice do not count)."""
        axes = [axis for axis, n in enumerate(self.labels.shape) if n > 1]
        return any(
            bool(np.take(self.labels, end, axis=axis).any()) for axis in axes for end in (0, -1)
        )

    @property
    def estimates(self) -> Estimates:
        """Best estimates of the true volume, area and diameter: by the edge in the image, not by the surface alone.

        Where the image has no edge to measure by, and of an image of one slice, volume and area are the
        surface's.
        """
        return self._by_edge[0]

    @property
    def intervals(self) -> Intervals | None:
        """Intervals around the `estimates` that hold the true volume, area and diameter in 95 of 100 cases.

        None without an edge, or of an image of one slice; that of a measure is None where its error cannot be told.
        """
        return self._by_edge[1]

    @cached_property
    def _by_edge(self) -> tuple[Estimates, Intervals | None]:
        found = None
        if self.has_surface:
            found = edge_measures(self.psi, self.image, self.geometry, self.volume_mm3)
        if found is None:
            return Estimates(self.volume_mm3, self.area_mm2, None), None
        return estimates(found)

    @cached_property
    def quality(self) -> Quality:
        """Measures of quality that need no reference."""
        learned = None if self.learned is None else ValueRange(*self.learned)
        before = None if self.before is None else self.before.value
        seen = Judged(
            self.labels,
            self.image,
            self.geometry,
            self.history,
            self.stop,
            learned,
            self.plateaus,
            self.clicked,
            self.confidence,
        )
        return assess(seen, before)


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The result of a run of one or several objects.

    Attributes
    ----------
    objects : tuple of SegmentedObject
        In order of their ids.
    has_ids : bool
        Whether objects with ids were given; else there is one, and its label is 1.
    image : ndarray (nz, ny, nx), float32
        The image as the energy saw it: presmoothed, 0 and 1 at its `preprocessing.SCALE_PERCENTILES`.
    geometry : Geometry
    config : RunConfig
    energy : str
        Name of the energy: that of ``config``, or ``custom: ClassName``.
    volume : Volume
        The input.
    seconds : dict of str to float
        Wall time of the parts ``start`` and ``evolve``.
    levels : list of LevelSummary
        The grids that it ran on, coarsest first, with the steps made on each; the last is the image's own.
    kernels : dict of str to float
        Seconds in each kernel while it evolved, over all threads.
    warnings : list of str
    start : ndarray or None
        psi of the start, for an image of one slice; None for volumes, where it would cost memory.
    given : tuple of str
        Settings that were given as arrays, meshes or lists in place of texts.
    edits_done : int
        Number of edits of ``config`` that were applied.
    resolved_settings : dict
        Values used for settings that depend on image and grid: see `accelsurf.output.document`.
    late_leakage : (float, float, float) or None
        Index (z, y, x) of the voxel near which the surfaces grew most in the last quarter of their growth; None without
        any, or where no object is any more.
    clicks : Clicks or None
        All clicks, on the image's grid.
    state : RunState or None
        The state from which `accelsurf.refine` continues; None with ``keep_state=no``.
    window : Window or None
        The part of a larger grid that ``geometry`` is; None where it is the whole.
    other_labels : ndarray (nz, ny, nx) or None
        Labels of a label map that is mended which its objects leave as they are; None without one.
    """

    objects: tuple[SegmentedObject, ...]
    has_ids: bool
    image: NDArray[np.float32]
    geometry: Geometry
    config: RunConfig
    energy: str
    volume: Volume
    seconds: dict[str, float] = field(default_factory=dict)
    levels: list[LevelSummary] = field(default_factory=list)
    kernels: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    start: NDArray[np.float32] | None = None
    edits_done: int = 0
    given: tuple[str, ...] = ()
    resolved_settings: dict[str, Any] = field(default_factory=dict)
    late_leakage: tuple[float, float, float] | None = None
    clicks: Clicks | None = None
    state: RunState | None = None
    window: Window | None = None
    other_labels: NDArray[np.integer[Any]] | None = None

    def __repr__(self) -> str:
        size = " x ".join(str(n) for n in self.geometry.size)
        content = f"{len(self.objects)} objects" if self.has_ids else "1 object"
        volume = size_text(self.volume_mm3, self.geometry.unit, 3)
        return f"Result({content}, {volume}, {self.stop.reason}, {size} voxels)"

    def _repr_html_(self) -> str:
        """A slice with the outlines of the objects, and the repr, for notebooks."""
        return thumbnail.as_html(repr(self), self.image, self.geometry, self.labels)

    @property
    def _one(self) -> SegmentedObject:
        return self.objects[0]

    @cached_property
    def by_id(self) -> Mapping[int, SegmentedObject]:
        """The objects by their ids."""
        return {segmented.id: segmented for segmented in self.objects}

    @cached_property
    def labels(self) -> NDArray[np.integer[Any]]:
        """The id of the object that a voxel's centre is inside of, 0 of none; (nz, ny, nx), uint8, uint16 or uint32.

        Of a label map that is mended the type is that of the map, as long as it holds all ids, and the other labels
        stay.
        """
        if not self.has_ids:
            return self._one.labels
        largest, others = self.objects[-1].id if self.objects else 0, self.other_labels
        kind = next(t for t in (np.uint8, np.uint16, np.uint32) if largest <= np.iinfo(t).max)
        labels = np.zeros(self.geometry.shape, kind)
        if others is not None:
            labels = others.astype(
                others.dtype if largest <= np.iinfo(others.dtype).max else np.uint32
            )
        for segmented in self.objects:
            labels[segmented.box][segmented.labels > 0] = segmented.id
        return labels

    def inside_on(self, box: Box) -> NDArray[np.bool_]:
        """True where a voxel's centre is in an object; of one object without its labels, which take memory."""
        return self.labels[box] > 0 if self.has_ids else self._one.psi[box] < 0

    @property
    def label_ids(self) -> tuple[int, ...]:
        """Ids of the objects, and the other labels of a map that is mended; in rising order."""
        ids = {segmented.id for segmented in self.objects}
        if self.other_labels is not None:
            ids |= {int(label) for label in np.unique(self.other_labels) if label > 0}
        return tuple(sorted(ids))

    @cached_property
    def psi(self) -> NDArray[np.float32]:
        """The smallest psi of all objects, mm, negative inside of any; a constant away from all."""
        if not self.has_ids:
            return self._one.psi
        far = max(float(np.abs(segmented.psi).max()) for segmented in self.objects)
        out = np.full(self.geometry.shape, far, np.float32)
        for segmented in self.objects:
            np.minimum(out[segmented.box], segmented.psi, out=out[segmented.box])
        return out

    @cached_property
    def stop(self) -> Stop:
        """Why the run ended; of several objects ``converged`` if all that remain did, ``vanished`` if none remains,
        else the worst reason.
        """
        return (
            overall_stop([segmented.stop for segmented in self.objects])
            if self.has_ids
            else self._one.stop
        )

    @cached_property
    def history(self) -> list[StepRecord]:
        """The record of each step; of several objects, sums and largest values over them."""
        if not self.has_ids:
            return self._one.history
        return _combined_history(
            [segmented.history for segmented in self.objects if segmented.history]
        )

    @cached_property
    def run_history(self) -> list[StepRecord]:
        """`history` without corrections, whose potentials belong to their boxes and compare with no others."""
        edits = {edit.step for edit in self.config.edit[: self.edits_done]}
        histories = [
            _before_corrections(segmented.history, edits)
            for segmented in self.objects
            if segmented.history
        ]
        return _combined_history(histories) if self.has_ids else [*histories, []][0]

    @cached_property
    def terms(self) -> list[dict[str, Any]]:
        """The terms of the energy with their settings; "by object" where they differ between objects."""
        return (
            _common_terms([segmented.terms for segmented in self.objects])
            if self.has_ids
            else self._one.terms
        )

    @property
    def learned(self) -> tuple[float, float] | None:
        """Range of values that the learned model expects in a single object; None for several."""
        return None if self.has_ids else self._one.learned

    @cached_property
    def surface(self) -> Surface:
        """All surfaces as one mesh in world mm (LPS), normals outward.

        Raises
        ------
        InputError
            When no object is left.
        """
        if not self.has_ids:
            return self._one.surface
        meshes = [segmented.surface for segmented in self.objects if segmented.has_surface]
        if not meshes:
            raise InputError(
                "no object is left, so there is no surface", "start closer to the objects"
            )
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
        return Surface(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))

    @cached_property
    def contours(self) -> Contours:
        """The contours of all objects of an image of one slice, in world mm (LPS).

        Raises
        ------
        InputError
            For a volume: it has a `surface`.
        """
        if not self.has_ids:
            return self._one.contours
        return Contours(
            tuple(
                loop
                for segmented in self.objects
                if segmented.has_surface
                for loop in segmented.contours.loops
            )
        )

    def labels_volume(self) -> Volume:
        """The labels on the input's grid with its header."""
        return self.volume.with_array(self.labels)

    @property
    def volume_mm3(self) -> float:
        """Volume within all surfaces, mm3, sub-voxel; see `estimates` for that of the objects."""
        return sum(segmented.volume_mm3 for segmented in self.objects)

    @property
    def area_mm2(self) -> float:
        """Area of their surfaces, mm2; where two touch, it counts for both."""
        return sum(segmented.area_mm2 for segmented in self.objects)

    @property
    def enclosed_mm2(self) -> float | None:
        """Area of all objects in an image of one slice, mm2; None for a volume."""
        is_2d = self.geometry.slice_axis is not None
        return sum(segmented.enclosed_mm2 or 0.0 for segmented in self.objects) if is_2d else None

    @property
    def length_mm(self) -> float | None:
        """Length of all contours in an image of one slice, mm; None for a volume."""
        is_2d = self.geometry.slice_axis is not None
        return sum(segmented.length_mm or 0.0 for segmented in self.objects) if is_2d else None

    @property
    def components(self) -> int:
        """Number of 6-connected parts of all objects."""
        return sum(segmented.components for segmented in self.objects)

    @property
    def touches_border(self) -> bool:
        """True if any object lies on the border of its grid."""
        return any(segmented.touches_border for segmented in self.objects)

    @property
    def estimates(self) -> Estimates:
        """Best estimates of the true measures: of several objects the sums of volumes and areas, and no diameter."""
        if not self.has_ids:
            return self._one.estimates
        volumes, areas = (
            [getattr(segmented.estimates, key) for segmented in self.objects]
            for key in ("volume_mm3", "area_mm2")
        )
        return Estimates(sum(volumes), sum(areas), None)

    @property
    def intervals(self) -> Intervals | None:
        """Intervals around the estimates of a single object; None for several, which have their own."""
        return None if self.has_ids else self._one.intervals

    @property
    def quality(self) -> Quality | None:
        """Measures of quality of a single object, without a reference; None for several, which have their own."""
        if self.has_ids:
            return None
        found: Quality = self._one.quality
        if self.window is None or found.next_click is None:
            return found
        return found._replace(next_click=self.window.place_on_whole(found.next_click))

    def plot(self, **options: Any) -> Any:
        """Show the result in a notebook or a window, or write a picture or a page; options as of `accelsurf.show`."""
        # By its public name and only when called: the viewer is a layer above this one, which no import may name.
        return importlib.import_module("accelsurf").show(self, **options)

    @property
    def report(self) -> dict[str, Any]:
        """The run as the JSON report has it, without files."""
        # By its public name, as `plot`: the report is a layer above this one.
        described: dict[str, Any] = importlib.import_module("accelsurf").report_of(self)
        return described


#: Public name of a result of several objects: it is a `Result`.
ObjectsResult = Result


def _combined_history(histories: list[list[StepRecord]]) -> list[StepRecord]:
    """The history of several objects together, by step.

    Energies, mass, volume and area are summed; the columns of `_LARGEST` have the largest value of any object; the
    other columns are the first one's. An object that has stopped counts with its last record.
    """
    records = []
    for step in range(max(map(len, histories))):
        now = [history[min(step, len(history) - 1)] for history in histories]
        sums = {key: sum(getattr(record, key) for record in now) for key in _SUMMED}
        largest = {key: max((getattr(record, key) for record in now), key=abs) for key in _LARGEST}
        records.append(now[0]._replace(step=step, restarted=False, **sums, **largest))
    return records


def _before_corrections(history: list[StepRecord], edits: set[int]) -> list[StepRecord]:
    """The records of a run without later corrections; ``edits`` are the steps of edits of the run itself.

    A correction counts as an edit before its first step, and replaces the record of the final state.
    """
    begun = [n for n, row in enumerate(history) if n and row.edits and row.step not in edits]
    return history[: begun[0]] if begun else history


def _common_terms(terms: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """The terms of all objects; "by object" where a setting differs. Objects that began later may have other terms.

    Examples
    --------
    >>> _common_terms([[{"term": "threshold", "LO": 3}], [{"term": "threshold", "LO": 4}]])
    [{'term': 'threshold', 'LO': 'by object'}]
    >>> _common_terms([[{"term": "chan-vese"}], [{"term": "seeded"}]])
    [{'term': 'chan-vese'}, {'term': 'seeded'}]
    """
    same: dict[tuple[Any, int], list[dict[str, Any]]] = {}
    for of_object in terms:
        counts = Counter[Any]()
        for term in of_object:
            name = term.get("term")
            same.setdefault((name, counts[name]), []).append(term)
            counts[name] += 1
    common = []
    for alike in same.values():
        term = dict(alike[0])
        for key, value in alike[0].items():
            if any(other.get(key) != value for other in alike):
                term[key] = "by object"
        common.append(term)
    return common


def plateaus_of(found: Sequence[FoundPlateau], prepared: PreprocessedInput) -> tuple[Plateau, ...]:
    """Return the plateaus of an object, with their places in the world."""
    return tuple(
        Plateau(
            found_plateau.step,
            found_plateau.volume_mm3,
            found_plateau.left_at,
            _place_of(found_plateau, prepared.geometry),
        )
        for found_plateau in found
    )


def plateaus_on_whole(plateaus: Sequence[Plateau], window: Window) -> tuple[Plateau, ...]:
    """The plateaus of an object in a window, with their places on the whole grid, to the last digit."""
    return tuple(
        plateau._replace(place=window.place_on_whole(plateau.place)) for plateau in plateaus
    )


def _place_of(plateau: FoundPlateau, geometry: Geometry) -> tuple[float, float, float]:
    """Return the world place (x, y, z), mm, of the middle of a voxel of a plateau's level."""
    grid = pyramid.levels(geometry.shape, geometry.spacing, plateau.level + 1)[plateau.level]
    middle = [
        f + i * width for f, i, width in zip(grid.first, plateau.place, grid.factors, strict=True)
    ]
    x, y, z = (float(v) for v in geometry.index_to_world(middle))
    return x, y, z


class BoxMask(NamedTuple):
    """Voxels: a ``mask`` of bool on a ``box`` of the grid."""

    box: Box
    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RunState:
    """Inputs of a correction besides the surfaces and settings of a `Result`.

    Attributes
    ----------
    prepared : PreprocessedInput
        Image and mask of the run.
    contexts : mapping of int to ImageContext
        Of each object.
    energy : Energy or callable or None
        One of the user's own; None for one with a name.
    clicks : Clicks or None
        All clicks so far, on the grid of the region of interest; None for none.
    models : mapping of int to ClickModel
        Of each object whose model corrections have needed, after all of them.
    totals : mapping of str to ndarray (2, m)
        Of `accelsurf.run.region_totals.RegionTotals`; empty before the first correction.
    settings : mapping of int to RunConfig
        Of objects whose settings are not the run's: corrections have begun them.
    masks : mapping of int to BoxMask
        By the number of a correction, on the grid of the region of interest: voxels that its new object may not have,
        or that were split off.
    """

    prepared: PreprocessedInput
    contexts: Mapping[int, ImageContext] = field(default_factory=dict)
    energy: EnergyLike | None = None
    clicks: Clicks | None = None
    models: Mapping[int, Any] = field(default_factory=dict)
    totals: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    settings: Mapping[int, RunConfig] = field(default_factory=dict)
    masks: Mapping[int, BoxMask] = field(default_factory=dict)
