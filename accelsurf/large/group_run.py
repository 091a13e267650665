"""Runs of groups of objects of an image that is read in parts: which may meet, and how far each object came."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import (
    Box,
    Corner,
    bounding_box,
    box_at,
    corner_of,
    enclosing,
    meeting,
    placed_at,
    widened,
)
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import LeavesWindow, Window
from accelsurf.interact import result_of
from accelsurf.large.first_window import MIN_MARGIN
from accelsurf.large.windowed import LargeImage, LargeRun, larger
from accelsurf.run import (
    PLAIN_BYTES,
    PROCESS_BYTES,
    Run,
    SegmentedObject,
    bytes_text,
    cropped,
    plateaus_on_whole,
    window_reach,
)
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart

#: Bytes of a voxel of an object's own box, as of a whole run: image, psi twice, an index of the band, and the band; and
#: of a voxel of the window beside the file's own: the image as float32, the union of the starts, and a copy of either.
_BOX_BYTES = PLAIN_BYTES
_WINDOW_BYTES = 12
#: Voxels by which a band may grow in a round, and by which stencils extend.
REACH = 3
_ALONE = "give --roi around them, or let the image be read into memory (more --max-memory)"
#: Positions of objects that are run at once, ascending.
Group = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class GroupResult:
    """The result of a run of some objects.

    Attributes
    ----------
    objects : tuple of SegmentedObject
        In order of their ids; boxes and grids are the whole image's.
    low, high : ndarray (n, 3) of int64
        Of each object, the box of all voxels where another could have met it at any time: the first, and the one after
        the last. Empty where it had no surface at all.
    window : Window
        The last one.
    energy : str
    resolved_settings : dict
    warnings : list of str
    """

    objects: tuple[SegmentedObject, ...]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    window: Window
    energy: str
    resolved_settings: dict[str, Any]
    warnings: list[str]


class TooLarge(InputError):
    """A group needs more memory than it may take."""


class MeetsOthers(Exception):
    """An object came to where others begin, so that all must be run at once: ``places`` among the boxes given."""

    def __init__(self, places: Sequence[int]) -> None:
        super().__init__(f"{len(places)} other objects are near")
        self.places = tuple(places)


class Boxes(NamedTuple):
    """Boxes on the whole grid: ``low`` (n, 3), the first voxel of each, and ``high``, the one after its last."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]


#: Settings that depend on all objects at once, or on the whole image.
_OF_ALL = "edit refine checkpoint roi box mask inside outside foreground background"


def check_settings(config: RunConfig) -> None:
    """Refuse settings that depend on all objects at once, or on the whole image.

    Raises
    ------
    UsageError
        Naming the setting.
    """
    given = [name for name in _OF_ALL.split() if getattr(config, name)]
    if config.levels not in ("auto", 1):
        given.append("levels")  # the first one on which all starts are resolved
    if config.noise > 0:
        given.append("noise")  # the seed of each goes by its place among all
    if given:
        raise UsageError(
            f"{given[0]}: it was given for objects of an image that is read in parts", _ALONE
        )
    for term in config.terms:
        if TERMS[term.name].uses_model:
            raise UsageError(
                f"energy: {term.name} is of clicks, and the image of the objects is read in parts",
                _ALONE,
            )
        if term.settings.get("update") == "no":
            raise UsageError(
                f"energy: {term.name}:update=no learns outside of all objects, and the image is read in parts",
                _ALONE,
            )


def run_group(large: LargeRun, starts: list[ObjectStart], others: Boxes) -> GroupResult:
    """Run some objects in a window that is made larger until they stay within it.

    Parameters
    ----------
    large : LargeRun
        Its settings are those that `check_settings` lets pass.
    starts : list of ObjectStart
        On the whole grid, in order of their ids.
    others : Boxes
        Where objects begin that are not among these.

    Raises
    ------
    MeetsOthers
        When one comes to where others begin.
    InputError
        As of `accelsurf.segment_objects`; TooLarge when the window that they need is larger than memory.
    """
    image = large.image
    reach = window_reach(large.config, image.geometry)
    window = Window(image.geometry, _first_box(starts, image.geometry, reach))
    while True:
        _refuse_too_large(window, starts, image)
        try:
            return _result_in(window, large, starts, others)
        except LeavesWindow as face:
            most = (image.max_bytes - _fixed_bytes(starts)) // _voxel_bytes(image)
            window = larger(window, face, most)


def _first_box(starts: list[ObjectStart], geometry: Geometry, reach: float) -> Box:
    """The starts, and around them as much as the largest is wide, and as their energies see (``reach``, mm)."""
    boxes = [box_at(start.corner, start.psi.shape) for start in starts]
    widest = max(n for start in starts for n in start.psi.shape)
    margin = [
        max(MIN_MARGIN, widest, math.ceil(reach / h) + MIN_MARGIN // 2) for h in geometry.spacing
    ]
    return widened(functools.reduce(enclosing, boxes), geometry.shape, margin)


def _refuse_too_large(window: Window, starts: list[ObjectStart], image: LargeImage) -> None:
    """Refuse a window whose run would take more memory than it may.

    Raises
    ------
    TooLarge
        With the estimate.
    """
    needed = _fixed_bytes(starts) + _voxel_bytes(image) * math.prod(window.shape)
    if needed > image.max_bytes:
        size = " x ".join(str(n) for n in reversed(window.shape))
        what = (
            f"object {starts[0].id} needs"
            if len(starts) == 1
            else f"{len(starts)} objects that may meet need"
        )
        raise TooLarge(
            f"{what} a window of {size} voxels, for which a run takes about {bytes_text(needed)} of memory; "
            f"{bytes_text(image.max_bytes)} are allowed",
            "take a coarser level of the image (--level), fewer --jobs, or more --max-memory",
        )


def _fixed_bytes(starts: list[ObjectStart]) -> int:
    """Return the memory of a run that does not depend on its window, bytes."""
    boxes = sum(math.prod(n + MIN_MARGIN for n in start.psi.shape) for start in starts)
    return PROCESS_BYTES + _BOX_BYTES * boxes


def _voxel_bytes(image: LargeImage) -> int:
    """Return the memory of a run for each voxel of its window, bytes."""
    return sum(_WINDOW_BYTES + channel.dtype.itemsize for channel in image.channels)


def _result_in(
    window: Window, large: LargeRun, starts: list[ObjectStart], others: Boxes
) -> GroupResult:
    """Return the result of the run in a window."""
    local = tuple(
        start._replace(corner=corner_of(window.local(box_at(start.corner, start.psi.shape))))
        for start in starts
    )
    with large.in_window(window, local) as run:
        visited = VisitedBoxes(run, window.corner)
        visited.refuse_near(others)
        while run.step():
            visited.look()
            visited.refuse_near(others)
        visited.look_at_ends()
        visited.refuse_near(others)
        result = result_of(run)
    found = tuple(_on_whole(segmented, window) for segmented in result.objects)
    return GroupResult(
        found, *visited.boxes, window, result.energy, result.resolved_settings, result.warnings
    )


class VisitedBoxes:
    """Boxes in which each object of a run was at any time, as far as it matters to others.

    The objects of a run look at each other only where their bands, made larger by `REACH`, overlap; at the end all that
    is not far outside of one counts for the others.

    Parameters
    ----------
    run : Run
        Before its first step.
    first : (z, y, x)
        First voxel of its grid in the whole grid.
    """

    def __init__(self, run: Run, first: Corner) -> None:
        self._run, self._first = run, np.array(first, np.int64)
        far = np.iinfo(np.int64).max // 2
        self._low, self._high = (
            np.full((len(run.objects), 3), far),
            np.full((len(run.objects), 3), -far),
        )
        self._larger: set[int] = set()
        self.look()

    def look(self) -> None:
        """Add where the objects are now."""
        for place, evolving in enumerate(self._run.objects):
            if evolving.surface.size:
                low, high = evolving.extent()
                self._add(place, low - REACH, high + REACH)

    def look_at_ends(self) -> None:
        """Add the voxels that are not far outside of the last surfaces."""
        for place, evolving in enumerate(self._run.objects):
            box = bounding_box(evolving.surface.psi < evolving.surface.gamma)
            if box is not None:
                low = np.array([side.start for side in box], np.int64) + np.array(
                    evolving.corner, np.int64
                )
                self._add(place, low, low + [side.stop - side.start for side in box])

    def _add(self, place: int, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        low, high = low + self._first, high + self._first
        if (low < self._low[place]).any() or (high > self._high[place]).any():
            self._low[place] = np.minimum(self._low[place], low)
            self._high[place] = np.maximum(self._high[place], high)
            self._larger.add(place)

    def refuse_near(self, others: Boxes) -> None:
        """Refuse to continue where others begin.

        Raises
        ------
        MeetsOthers
        """
        near = np.zeros(len(others.low), np.bool_)
        for place in self._larger:
            near |= ((others.low < self._high[place]) & (others.high > self._low[place])).all(
                axis=1
            )
        self._larger.clear()
        if near.any():
            raise MeetsOthers(np.flatnonzero(near).tolist())

    @property
    def boxes(self) -> Boxes:
        """The box of each object on the whole grid; empty where it had no surface at all."""
        there = np.all(self._low < self._high, axis=1, keepdims=True)
        return Boxes(np.where(there, self._low, 0), np.where(there, self._high, 0))


def _on_whole(segmented: SegmentedObject, window: Window) -> SegmentedObject:
    """An object of a run in a window, on the whole grid: its places are worked out there, to the last digit."""
    box = placed_at(segmented.box, window.corner)
    plateaus = plateaus_on_whole(segmented.plateaus, window)
    return replace(segmented, box=box, geometry=cropped(window.geometry, box), plateaus=plateaus)


def united(
    groups: Sequence[Group],
    low: NDArray[np.integer],
    high: NDArray[np.integer],
    pairs: Sequence[tuple[int, int]] = (),
) -> list[Group]:
    """Return groups of which no two have objects whose boxes overlap; one that need not grow is as it was.

    Parameters
    ----------
    groups : sequence of tuple of int
        Disjoint.
    low, high : ndarray (n, 3) of int
        First voxel of the box of each object, and the one after its last. An empty box overlaps none.
    pairs : sequence of (int, int), optional
        Objects that belong to one group whatever their boxes are.

    Returns
    -------
    list of tuple of int
        In order of their first objects, whatever the order of ``groups``.

    Examples
    --------
    >>> low = np.array([[0, 0, 0], [9, 0, 0], [2, 0, 0], [9, 9, 9]])
    >>> united([(0,), (1,), (2,), (3,)], low, np.array([[3, 1, 1], [9, 0, 0], [4, 1, 1], [10, 10, 10]]))
    [(0, 2), (1,), (3,)]
    """
    members = np.array(sorted(place for group in groups for place in group), np.int64)
    group_of = {place: number for number, group in enumerate(groups) for place in group}
    there = members[(low[members] < high[members]).all(axis=1)]
    near = meeting(low[there], high[there])
    overlaps = [
        (first_place, int(there[j]))
        for first_place, found in zip(there.tolist(), near, strict=True)
        for j in found
    ]
    ends = np.array([[group_of[a], group_of[b]] for a, b in (*pairs, *overlaps)], int).reshape(
        -1, 2
    )
    links = coo_matrix((np.ones(len(ends)), ends.T), (len(groups), len(groups)))
    joined: dict[int, list[int]] = {}
    for number, group in zip(connected_components(links, False)[1], groups, strict=True):
        joined.setdefault(number, []).extend(group)
    return sorted(tuple(sorted(group)) for group in joined.values())
