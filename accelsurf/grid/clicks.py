"""Clicks: voxels that a person has said to lie in the object or outside of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, common, corner_of, counted_from, on_box, overlap, tightened

Side = Literal["inside", "outside"]
#: The two sides, and the id of the background.
SIDES: tuple[Side, Side] = ("inside", "outside")
NO_OBJECT = 0


class Click(NamedTuple):
    """Voxels that a person has named at once: a point, a ball, a stroke.

    Attributes
    ----------
    side : {"inside", "outside"}
        Of the object ``id``.
    box : tuple of slice
        Part of the grid.
    mask : ndarray of bool
        The voxels, of the shape of the box.
    id : int
        The object; 1 where there is one alone, 0 for "no object".
    owner : int or None
        As one object sees it: the id inside which it was clicked; None of an outside click.
    near : float or None
        How far from it the object may change, mm, as the person asked; None where that follows from the click.
    """

    side: Side
    box: Box
    mask: NDArray[np.bool_]
    id: int = 1
    owner: int | None = None
    near: float | None = None

    def mask_on(self, box: Box) -> NDArray[np.bool_]:
        """Return its voxels on a box of the grid; none where it lies elsewhere."""
        return on_box(self.mask, self.box, box, False)

    def contradicts(self, other: Click) -> bool:
        """Test if no voxel can be in both: some object would have it inside and outside."""
        if self.side == other.side:
            return self.side == "inside" and self.id != other.id
        return self.id == other.id

    def without(self, later: Iterable[Click]) -> Click | None:
        """Return the voxels that later clicks leave it; itself where those are all, None where there are none."""
        mask = self.mask
        for click in later:
            if click.contradicts(self) and overlap(click.box, self.box):
                mask = mask & ~click.mask_on(self.box)
        if mask is self.mask or np.array_equal(mask, self.mask):
            return self
        left = tightened(self.box, mask)
        return None if left is None else self._replace(box=left[0], mask=left[1])


@dataclass(frozen=True, eq=False)
class Clicks:
    """Clicks on one grid, in the order in which they were given.

    Attributes
    ----------
    clicks : tuple of Click
    shape : (nz, ny, nx)
        Of the grid.

    Examples
    --------
    >>> one = Click("inside", (slice(0, 1), slice(0, 1), slice(2, 4)), np.ones((1, 1, 2), bool))
    >>> clicks = Clicks((one,), (1, 1, 5))
    >>> clicks.mask("inside")
    array([[[False, False,  True,  True, False]]])
    >>> clicks.mask("outside").any(), len(clicks)
    (np.False_, 1)
    """

    clicks: tuple[Click, ...]
    shape: tuple[int, int, int]

    def __len__(self) -> int:
        """Number of clicks."""
        return len(self.clicks)

    def mask(self, side: Side, id: int = 1) -> NDArray[np.bool_]:
        """Return the voxels (nz, ny, nx) clicked on one side of an object; all False where there are none."""
        out = np.zeros(self.shape, np.bool_)
        for click in self.clicks:
            if (click.side, click.id) == (side, id):
                out[click.box] |= click.mask
        return out

    def of(self, id: int) -> Clicks:
        """Return the clicks as one object sees them, as if it were alone: all have the id 1.

        Inside are the inside clicks of ``id``; outside are its outside clicks, and the inside clicks of all other ids,
        0 included.
        """
        seen: list[Click] = []
        for click, foreign in zip(self.clicks, self._foreign, strict=True):
            if click.id == id:
                seen.append(
                    click._replace(id=1, owner=click.id if click.side == "inside" else None)
                )
            elif foreign is not None:
                seen.append(foreign)
        return Clicks(tuple(seen), self.shape)

    @cached_property
    def _foreign(self) -> tuple[Click | None, ...]:
        """Each click as objects of other ids see it; None of outside clicks."""
        foreign: list[Click | None] = []
        for click in self.clicks:
            is_inside = click.side == "inside"
            foreign.append(
                click._replace(side="outside", id=1, owner=click.id) if is_inside else None
            )
        return tuple(foreign)

    def ids(self) -> tuple[int, ...]:
        """Return the ids that have inside clicks, in rising order."""
        return tuple(sorted({click.id for click in self.clicks if click.side == "inside"}))

    def near(self, box: Box) -> Clicks:
        """Return the clicks of which a voxel may lie in a box."""
        return Clicks(tuple(click for click in self.clicks if overlap(click.box, box)), self.shape)

    def on_side(self, side: Side) -> Clicks:
        """Return the clicks on a side."""
        return Clicks(tuple(click for click in self.clicks if click.side == side), self.shape)

    def on_box(self, box: Box) -> Clicks:
        """Return the clicks on a part of the grid, counted from its first voxel; voxels beyond are left out."""
        nz, ny, nx = (s.stop - s.start for s in box)
        clipped = (_click_on_box(click, box) for click in self.clicks)
        return Clicks(tuple(click for click in clipped if click is not None), (nz, ny, nx))

    def with_more(self, more: Iterable[Click]) -> Clicks:
        """Return these clicks and some after them."""
        return Clicks((*self.clicks, *more), self.shape)

    def with_later(self, later: Sequence[Click]) -> Clicks:
        """Return these clicks and later ones, which take the voxels that they put on the other side from these.

        A click of which nothing is left is left out; one from which nothing is taken stays the same object.

        Examples
        --------
        >>> here = (slice(0, 1), slice(0, 1), slice(2, 4))
        >>> clicks = Clicks((Click("inside", here, np.ones((1, 1, 2), bool)),), (1, 1, 5))
        >>> there = (slice(0, 1), slice(0, 1), slice(3, 5))
        >>> clicks = clicks.with_later([Click("outside", there, np.ones((1, 1, 2), bool))])
        >>> clicks.mask("inside"), clicks.mask("outside")
        (array([[[False, False,  True, False, False]]]), array([[[False, False, False,  True,  True]]]))
        """
        left = (click.without(later) for click in self.clicks)
        return Clicks((*(click for click in left if click is not None), *later), self.shape)

    def starts_with(self, other: Clicks) -> bool:
        """Test if these are other clicks, unchanged, and maybe more."""
        return len(self) >= len(other) and all(map(_same, other.clicks, self.clicks))


def _same(first: Click, second: Click) -> bool:
    same = (first.side, first.box, first.near) == (second.side, second.box, second.near)
    return first is second or (same and np.array_equal(first.mask, second.mask))


def _click_on_box(click: Click, box: Box) -> Click | None:
    """A click on a box of the grid; None where it has no voxel there."""
    if not overlap(click.box, box):
        return None
    part = common(click.box, box)
    mask = click.mask_on(part)
    return click._replace(box=counted_from(part, corner_of(box)), mask=mask) if mask.any() else None
