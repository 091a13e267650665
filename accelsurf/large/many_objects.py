"""Many objects in an image that is read in parts: in groups, each as if all were run at once in memory.

Objects matter to each other only where they are neighbours. So they are run in groups, and where an object of one
group could have met one of another at any time, both groups are run again as one. The result has the bytes of a run
of all objects on the whole image: see record 0031.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.grid.boxes import meeting
from accelsurf.io import LazyVolume
from accelsurf.large import object_starts
from accelsurf.large.group_run import (
    Boxes,
    Group,
    GroupResult,
    MeetsOthers,
    check_settings,
    run_group,
    united,
)
from accelsurf.large.object_starts import LabelMap, ManyStarts
from accelsurf.large.whole_image import Numbers, WholeImage
from accelsurf.large.windowed import LargeImage, LargeRun
from accelsurf.run import AROUND, ImageContext, SegmentedObject, TermInputs, make_term
from accelsurf.settings.run_config import RunConfig

#: Objects whose starts are nearer to each other than twice this many voxels are run at once from the beginning.
MARGIN = 6
#: A run that comes to where others begin ends at once, as it would not count; so only this many others are checked.
MAX_OTHERS = 200
#: Others that begin farther away than twice this number of extents of the starts are not checked.
FAR = 8


class ObjectOutcome(NamedTuple):
    """The outcome of an object: an ``object``, or a ``failure`` that says why there is none."""

    id: int
    object: SegmentedObject | None
    failure: str | None = None


def _first_groups(starts: ManyStarts, margin: int = MARGIN) -> list[Group]:
    """Return the groups that objects are run in first: those whose starts are near each other.

    Parameters
    ----------
    starts : ManyStarts
    margin : int, optional
        Voxels around the box of each start. The result does not depend on it.
    """
    return united(
        [(place,) for place in range(len(starts.ids))], starts.low - margin, starts.high + margin
    )


class Groups:
    """Groups of objects, united until no two of them could have met.

    Parameters
    ----------
    starts : ManyStarts
    margin : int, optional
        As of `_first_groups`.

    Attributes
    ----------
    waiting : list of tuple of int
        Groups that are to be run, by the positions of their objects.
    """

    def __init__(self, starts: ManyStarts, margin: int = MARGIN) -> None:
        self._starts, self.waiting = starts, _first_groups(starts, margin)
        self._ended: list[Group] = []
        # As far as an object may well grow: several times the extent of its start.
        reach = margin + FAR * (starts.high - starts.low).max(axis=1, keepdims=True, initial=1)
        self._near = meeting(starts.low - reach, starts.high + reach)
        self._failed = np.zeros(len(starts.ids), np.bool_)
        self._pairs: list[tuple[int, int]] = []
        # Objects that failed stay empty: they meet none.
        self._low, self._high = np.zeros((2, len(starts.ids), 3), np.int64)

    def others(self, group: Group) -> list[int]:
        """Positions of at most `MAX_OTHERS` objects that begin near a group and are not in it, none that has failed."""
        near = {other for place in group for other in self._near[place]} - set(group)
        places = np.array(sorted(place for place in near if not self._failed[place]), np.int64)
        if places.size > MAX_OTHERS:
            low, high = self._starts.low, self._starts.high
            first, end = low[list(group)].min(axis=0), high[list(group)].max(axis=0)
            gap = np.maximum(np.maximum(low[places] - end, first - high[places]), 0).max(axis=1)
            places = np.sort(places[np.argsort(gap, kind="stable")[:MAX_OTHERS]])
        return [int(place) for place in places]

    def starts_of(self, places: Sequence[int]) -> Boxes:
        """Return the boxes of the starts of some objects."""
        return Boxes(self._starts.low[list(places)], self._starts.high[list(places)])

    def put(self, group: Group, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Take note of a group that was run: the boxes of its objects, as of `GroupResult`."""
        self._end(group)
        self._low[list(group)], self._high[list(group)] = low, high

    def put_near(self, group: Group, others: Sequence[int]) -> None:
        """Take note of a group that came to where others begin, by their positions."""
        self._end(group)
        self._pairs += [(group[0], other) for other in others]

    def put_failed(self, group: Group) -> None:
        """Take note of a group that cannot be run: its objects meet none."""
        self._end(group)
        self._failed[list(group)] = True

    def _end(self, group: Group) -> None:
        self.waiting.remove(group)
        self._ended.append(group)
        self._low[list(group)] = self._high[list(group)] = 0

    def unite(self) -> list[Group]:
        """Put those that could have met on the list again, as one group, once all have ended.

        Returns
        -------
        list of tuple of int
            Groups whose results do not count any more.
        """
        if self.waiting:
            raise ValueError(f"{len(self.waiting)} groups have not ended")
        pairs = [(place, other) for place, other in self._pairs if not self._failed[other]]
        # One that came near nothing but objects which have failed since is run again without them.
        again = {place for place, _ in self._pairs}
        before, after = set(self._ended), united(self._ended, self._low, self._high, pairs)
        self.waiting = [group for group in after if group not in before or group[0] in again]
        self._ended = [group for group in after if group not in set(self.waiting)]
        self._pairs = []
        return sorted(before - set(self._ended))


def segment_many_objects(
    image: LargeImage,
    objects: str | LazyVolume | ManyStarts,
    config: RunConfig | None = None,
    *,
    margin: int = MARGIN,
    on_group: Callable[[Sequence[int], GroupResult | str], None] | None = None,
    **options: Any,
) -> Iterator[ObjectOutcome]:
    """Segment many objects in an image that is read in parts.

    Parameters
    ----------
    image : LargeImage
    objects : str, LazyVolume or ManyStarts
        As for ``--objects``: a table of balls, or a label map that can be read in parts; or the map itself.
    config : RunConfig, optional
    margin : int, optional
        As of `_first_groups`.
    on_group : callable, optional
        Called with the ids of each group that has ended, and its result or why it failed.
    **options
        Settings by name; they override ``config``.

    Yields
    ------
    ObjectOutcome
        In order of the ids, after all have ended: each object on its box of the whole grid.

    Raises
    ------
    UsageError
        When a setting depends on all objects at once.
    InputError
        When the image or the starts cannot be read.
    """
    config = (config or RunConfig()).replace(**options) if options else config or RunConfig()
    check_settings(config)
    image.check()
    starts = many_starts(objects, image)
    large = LargeRun(image, image.whole(config), config)
    groups, found = Groups(starts, margin), dict[Group, GroupResult | str]()
    while groups.waiting:
        for group in list(groups.waiting):
            others = groups.others(group)
            try:
                result = run_group(large, starts.made(group), groups.starts_of(others))
            except MeetsOthers as near:
                groups.put_near(group, [others[place] for place in near.places])
            except (AccelsurfError, MemoryError) as error:
                found[group] = failure_text(error)
                groups.put_failed(group)
            else:
                found[group] = result
                groups.put(group, result.low, result.high)
            if on_group is not None and group in found:
                on_group(starts.ids[list(group)].tolist(), found[group])
        for group in groups.unite():
            found.pop(group, None)
    yield from sorted(_outcomes(found.items(), starts))


def numbers_needed(whole: Sequence[WholeImage], config: RunConfig) -> tuple[Numbers, ...]:
    """Return the statistics of the whole image that the energy of any object needs, read through once.

    Parameters
    ----------
    whole : sequence of WholeImage
        Of each channel.
    config : RunConfig
    """
    shape = tuple(min(n, 8) for n in whole[0].geometry.shape)
    # The energy of a pattern asks for the same numbers, wherever it is; it has edges for terms that need some.
    pattern = (np.indices(shape).sum(axis=0) % 2).astype(np.float32)
    inside = np.zeros(shape, np.bool_)
    inside[tuple(slice(0, max(n // 2, 1)) for n in shape)] = True
    images = [pattern] * len(whole)
    context = ImageContext(
        images,
        [channel.scale for channel in whole],
        whole[0].geometry.spacing,
        inside,
        is_start=True,
        whole=whole,
    )
    context = context.of_object((0, 0, 0), inside)
    for term in config.terms:
        inputs = TermInputs(term.settings, config, pattern, whole[0].geometry.spacing, context)
        with suppress(UsageError):  # bounds that fit the objects need not fit the pattern
            make_term(term, inputs, images)
    return tuple(channel.numbers for channel in whole)


def many_starts(objects: str | LazyVolume | ManyStarts, image: LargeImage) -> ManyStarts:
    """The starts of objects, whatever they are given as."""
    if isinstance(objects, str):
        return object_starts.opened(objects, image.geometry, AROUND)
    if isinstance(objects, LazyVolume):
        return LabelMap("label map", objects, image.geometry, AROUND)
    return objects


def failure_text(error: BaseException) -> str:
    """Why a group failed, in a line."""
    if isinstance(error, AccelsurfError):
        return f"{error.message}; {error.hint}" if error.hint else error.message
    kind = "not enough memory" if isinstance(error, MemoryError) else f"{type(error).__name__}:"
    return f"{kind} {error}".strip()


def _outcomes(
    found: Iterable[tuple[Group, GroupResult | str]], starts: ManyStarts
) -> Iterator[ObjectOutcome]:
    for group, result in found:
        if isinstance(result, str):
            yield from (ObjectOutcome(int(starts.ids[place]), None, result) for place in group)
        else:
            yield from (ObjectOutcome(segmented.id, segmented) for segmented in result.objects)
