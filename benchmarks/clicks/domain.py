"""What the peers work on: a crop around the clicks, on a coarser grid where it is large, with what is surely outside.

One inside click says nothing about the outside, which all of the peers need. The rule for all of them: the crop reaches
``reach`` times the depth (twice the ball's radius) around the inside clicks; the crop's faces count as outside, but for
those nearer than half that margin to an inside click: there the object may well run on. Where all faces are that near,
the farthest counts. A drawn box is the crop, and what lies outside of it is outside. A person who uses such a program
marks the outside, or draws a box.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, connected_to, enclosing, whole_box, widened
from accelsurf.grid.clicks import SIDES, Click, Clicks, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.image.blocks import block_means, coarsening, on_voxels
from accelsurf.image.volume import Volume
from benchmarks.clicks.implied import implied
from benchmarks.clicks.person import Mask, PersonClick, ball_voxels

INSIDE, OUTSIDE = 1, 2
#: Values are cut at so many spreads from the median of the inside clicks, as a person sets a window.
WINDOW = 10.0
#: A crop reaches at least so many of the smallest spacing beyond inside clicks: thin things get clicks of one voxel.
LEAST_MARGIN = 12.0


class Domain(NamedTuple):
    """A crop, ready for a peer.

    ``values`` (float32): 0 at the median of the inside clicks, in units of their spread; ``seeds`` (uint8): 1 inside,
    2 outside, 0 open; ``spacing`` (z, y, x) of the grid in units of its smallest; ``clicks``: for each its side and
    the values in its ball.
    """

    values: NDArray[np.float32]
    seeds: NDArray[np.uint8]
    spacing: tuple[float, float, float]
    clicks: list[tuple[str, NDArray[np.float32]]]


#: Gives, on a domain's grid, a field that is above 0 inside.
Solver = Callable[[Domain, Mapping[str, Any]], NDArray[Any]]


class CroppedSession:
    """A peer in a crop: all clicks so far, solved anew at every click.

    Parameters
    ----------
    image : Volume
    solver : callable
    settings : mapping
        ``reach`` and what the solver takes; with ``implied`` what the clicks imply of the voxels around them
        (`benchmarks.clicks.implied`) counts as said.
    cap : int
        Voxels above which the crop is restricted.
    drawn : Box, optional
        The box that a person drew around the object: the crop is this box and a voxel more, and that voxel is outside.
    whole : bool
        Without a drawn box the crop is the whole scan: the clicks are points, which say nothing of a width.
    """

    def __init__(
        self,
        image: Volume,
        solver: Solver,
        settings: Mapping[str, Any],
        cap: int,
        drawn: Box | None = None,
        whole: bool = False,
    ) -> None:
        self.image = image
        self.solver = solver
        self.settings = settings
        self.cap = cap
        self.drawn, self.whole = drawn, whole
        self.clicks: list[PersonClick] = []

    def click(self, click: PersonClick) -> Mask:
        """Solve with one click more."""
        self.clicks.append(click)
        geometry = self.image.geometry
        box, margin = crop(self.clicks, geometry, self.settings["reach"])
        if self.whole:
            box = whole_box(geometry.shape)
        if self.drawn is not None:
            box = widened(self.drawn, geometry.shape, (1, 1, 1))
        for click_box, _ in (ball_voxels(each, geometry) for each in self.clicks):
            box = enclosing(box, click_box)
        steps = coarsening([side.stop - side.start for side in box], geometry.spacing, self.cap)
        hints = self._hints(box) if self.settings.get("implied") else []
        domain = made(
            self.image.array, geometry, self.clicks, box, steps, margin, hints, self.drawn
        )
        field = np.asarray(self.solver(domain, self.settings), np.float32)
        labels = np.zeros(geometry.shape, bool)
        labels[box] = on_voxels(field, steps, labels[box].shape) > 0
        if self.drawn is not None:
            inside = labels[self.drawn].copy()
            labels[:] = False
            labels[self.drawn] = inside
        for each in self.clicks:
            where, ball = ball_voxels(each, geometry)
            labels[where][ball] = each.side == "inside"
        return labels

    def _hints(self, box: Box) -> list[Click]:
        """What the clicks imply in a box."""
        shape = self.image.geometry.shape
        side: dict[str, Side] = {"inside": "inside", "outside": "outside"}
        clicks = [
            Click(side[each.side], *ball_voxels(each, self.image.geometry)) for each in self.clicks
        ]
        return implied(
            [self.image.as_float32()],
            self.image.geometry.spacing,
            Clicks(tuple(clicks), shape),
            box,
        )


def crop(clicks: Sequence[PersonClick], geometry: Geometry, reach: float) -> tuple[Box, float]:
    """The box that a peer gets, and the margin (mm) around the inside clicks."""
    margin = reach * 2 * max(each.radius for each in clicks if each.side == "inside")
    margin = max(margin, LEAST_MARGIN * min(geometry.spacing))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for each in clicks:
        width = margin if each.side == "inside" else 2 * each.radius
        extent = width / np.array(geometry.spacing)
        low, high = np.minimum(low, each.index - extent), np.maximum(high, each.index + extent)
    first = [max(math.floor(a), 0) for a in low]
    stop = [min(math.ceil(b) + 1, n) for b, n in zip(high, geometry.shape, strict=True)]
    return (slice(first[0], stop[0]), slice(first[1], stop[1]), slice(first[2], stop[2])), margin


def made(
    image: NDArray[Any],
    geometry: Geometry,
    clicks: Sequence[PersonClick],
    box: Box,
    steps: tuple[int, int, int],
    margin: float,
    hints: Sequence[Click] = (),
    drawn: Box | None = None,
) -> Domain:
    """Cut, coarsen, scale, and mark the seeds: clicks, and where none lies what they imply, unless two disagree."""
    part = image[box].astype(np.float32)
    sides = [
        np.any([each.mask_on(box) for each in hints if each.side == side] or [False], axis=0)
        for side in SIDES
    ]
    seeds = np.zeros(part.shape, np.uint8)
    seeds += (sides[0] & ~sides[1]).astype(np.uint8) * INSIDE + (sides[1] & ~sides[0]).astype(
        np.uint8
    ) * OUTSIDE
    balls: list[tuple[str, NDArray[np.float32]]] = []
    for each in clicks:
        where, ball = ball_voxels(each, geometry)
        inner = tuple(
            slice(a.start - b.start, a.stop - b.start) for a, b in zip(where, box, strict=True)
        )
        seeds[inner][ball] = INSIDE if each.side == "inside" else OUTSIDE
        balls.append((each.side, image[where][ball].astype(np.float32)))
    inside = np.concatenate([values for side, values in balls if side == "inside"])
    middle = np.median(inside)
    # The spread of a ball of very few voxels, or of a flat one, is that of its neighbourhood's gradient.
    gradient = [np.abs(np.diff(part, axis=axis)) for axis in range(3) if part.shape[axis] > 1]
    floor = 0.5 * float(np.median(np.concatenate([each.ravel() for each in gradient])))
    spread = max(
        1.4826 * float(np.median(np.abs(inside - middle))), floor, 1e-3 * float(np.ptp(part)), 1e-20
    )
    values = np.clip((part - middle) / np.float32(spread), -WINDOW, WINDOW)
    coarse = restricted_seeds(seeds, steps)
    faces = (
        outer_faces(clicks, geometry, box, margin) if drawn is None else faces_beyond(drawn, box)
    )
    for axis, end in faces:
        face = [slice(None)] * 3
        face[axis] = slice(0, 1) if end == 0 else slice(-1, None)
        layer = coarse[tuple(face)]
        layer[layer == 0] = OUTSIDE
    mm = np.array(geometry.spacing) * steps
    relative = mm / mm.min()
    scaled = [
        (side, np.clip((v - middle) / np.float32(spread), -WINDOW, WINDOW)) for side, v in balls
    ]
    return Domain(
        block_means(values, steps), coarse, (relative[0], relative[1], relative[2]), scaled
    )


def outer_faces(
    clicks: Sequence[PersonClick], geometry: Geometry, box: Box, margin: float
) -> list[tuple[int, int]]:
    """Faces (axis, end 0 or 1) of a crop that count as outside."""
    inside = [each.index for each in clicks if each.side == "inside"]
    far: dict[tuple[int, int], float] = {}
    for axis, end in itertools.product(range(3), range(2)):
        at = box[axis].start if end == 0 else box[axis].stop - 1
        far[axis, end] = min(abs(index[axis] - at) for index in inside) * geometry.spacing[axis]
    return [face for face, mm in far.items() if mm >= 0.5 * margin] or [
        max(far, key=lambda face: far[face])
    ]


def faces_beyond(drawn: Box, box: Box) -> list[tuple[int, int]]:
    """Faces (axis, end 0 or 1) of a crop that lie outside of the box that a person drew.

    Examples
    --------
    >>> faces_beyond((slice(0, 4), slice(1, 4), slice(1, 5)), (slice(0, 5), slice(0, 5), slice(0, 5)))
    [(0, 1), (1, 0), (1, 1), (2, 0)]
    """
    ends = [((axis, 0), box[axis].start < drawn[axis].start) for axis in range(3)]
    ends += [((axis, 1), box[axis].stop > drawn[axis].stop) for axis in range(3)]
    return sorted(face for face, beyond in ends if beyond)


def restricted_seeds(seeds: NDArray[np.uint8], steps: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Seeds of blocks: none is lost; a block with seeds of both sides gets neither."""
    sides = []
    for side in (INSIDE, OUTSIDE):
        out = seeds == side
        for axis, step in enumerate(steps):
            if step > 1:
                out = np.logical_or.reduceat(out, np.arange(0, out.shape[axis], step), axis)
        sides.append(out)
    both = sides[0] & sides[1]
    return np.where(both, 0, sides[0] * INSIDE + sides[1] * OUTSIDE).astype(np.uint8)


def connected(mask: Mask, seeds: NDArray[np.uint8]) -> Mask:
    """The parts of a mask that hold an inside seed."""
    return connected_to(mask | (seeds == INSIDE), seeds == INSIDE) & (seeds != OUTSIDE)
