"""What a person has said of voxels: these are in the object, those are not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, on_box, shared

Side = Literal["inside", "outside"]
#: The two sides, and the id of what is no object.
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
    """

    side: Side
    box: Box
    mask: NDArray[np.bool_]
    id: int = 1

    def mask_on(self, box: Box) -> NDArray[np.bool_]:
        """Return its voxels on a box of the grid; none where it lies elsewhere."""
        return on_box(self.mask, self.box, box, False)


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
        own: list[Click] = []
        for click in self.clicks:
            if click.id == id:
                own.append(click._replace(id=1))
            elif click.side == "inside":
                own.append(click._replace(side="outside", id=1))
        return Clicks(tuple(own), self.shape)

    def ids(self) -> tuple[int, ...]:
        """Return the ids that have inside clicks, in rising order."""
        return tuple(sorted({click.id for click in self.clicks if click.side == "inside"}))

    def on_box(self, box: Box) -> Clicks:
        """Return the clicks on a part of the grid, counted from its first voxel; what lies beyond is left out."""
        corner, shape = corner_of(box), tuple(s.stop - s.start for s in box)
        clipped = (_click_on_box(click, corner, (shape[0], shape[1], shape[2])) for click in self.clicks)
        return Clicks(tuple(one for one in clipped if one is not None), (shape[0], shape[1], shape[2]))

    def with_more(self, more: Iterable[Click]) -> Clicks:
        """Return these clicks and some after them."""
        return Clicks((*self.clicks, *more), self.shape)


def _click_on_box(click: Click, corner: Corner, shape: tuple[int, int, int]) -> Click | None:
    """A click on a box of the grid; None where it has no voxel there."""
    first = tuple(a - b for a, b in zip(corner_of(click.box), corner, strict=True))
    begin = (first[0], first[1], first[2])
    low = [max(a, 0) for a in begin]
    high = [min(a + n, m) for a, n, m in zip(begin, click.mask.shape, shape, strict=True)]
    if any(a >= b for a, b in zip(low, high, strict=True)):
        return None
    theirs, mine = shared((0, 0, 0), shape, begin, click.mask.shape)
    mask = click.mask[mine]
    return click._replace(box=box_at(corner_of(theirs), mask.shape), mask=mask) if mask.any() else None
