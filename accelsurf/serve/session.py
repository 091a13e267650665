"""Clients: who has a lease, and the image and object of each, in the client's order of axes."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import accelsurf
from accelsurf.errors import InputError
from accelsurf.serve import prompts
from accelsurf.serve.prompts import Box, Grid, Side

#: Channels of an image.
MAX_CHANNELS = 16
#: Seconds without any request, a heartbeat included, after which a client is gone.
LIVENESS = 60.0


class Answer(NamedTuple):
    """Labels, uint8, on the ``box`` in which they have changed since the last answer."""

    box: Box
    labels: NDArray[np.uint8]


class ImageSession:
    """An image and the object that a client clicks in it.

    Parameters
    ----------
    image : ndarray (channels, n, m, k)
    spacing : sequence of float or None
        mm, of the last three axes; 1 where the client does not say. Negative where its viewer shows the axis flipped.

    Attributes
    ----------
    shape : tuple of int
        (n, m, k).
    channels : int

    Raises
    ------
    InputError
        When it is no image.
    """

    def __init__(self, image: NDArray[Any], spacing: Sequence[float] | None) -> None:
        if image.ndim != 4:
            raise InputError(
                f"set_image: an array of {image.ndim} axes was sent, 4 expected",
                "send [channels, ...]",
            )
        self.channels, *axes = image.shape
        if self.channels > MAX_CHANNELS:
            raise InputError(
                f"set_image: {self.channels} channels were sent, at most {MAX_CHANNELS} expected"
            )
        self.shape = axes[0], axes[1], axes[2]
        given = tuple(spacing or (1.0, 1.0, 1.0))
        given = (1.0, *given) if len(given) == 2 and self.shape[0] == 1 else given
        if len(given) != 3:
            raise InputError(
                f"set_image: {len(given)} spacings were sent, 3 expected",
                "one for each axis, in mm",
            )
        # A viewer that shows a layer flipped has a negative scale along the axis; its arrays are not turned.
        sizes = tuple(abs(step) for step in given)
        self._grid = Grid(self.shape, (sizes[0], sizes[1], sizes[2]))
        # Along z, our first axis, an image may have one place.
        flat = self.shape.index(1) if 1 in self.shape else 0
        self._axes = (flat, *(axis for axis in range(3) if axis != flat))
        first, *others = (np.ascontiguousarray(channel.transpose(self._axes)) for channel in image)
        volume = accelsurf.Volume.from_array(first, [sizes[axis] for axis in self._axes])
        flips = [math.copysign(1.0, given[axis]) for axis in reversed(self._axes)]
        grid = volume.geometry
        volume = accelsurf.Volume(
            volume.array,
            accelsurf.Geometry(grid.shape, grid.spacing, grid.origin, np.diag(flips)),
        )
        self._object = accelsurf.Interaction(volume, channels=others)
        self._changed: Box | None = None
        self._waiting = 0

    @property
    def size(self) -> int:
        """Number of voxels."""
        return math.prod(self.shape)

    @property
    def is_waiting(self) -> bool:
        """True if there are prompts without an answer."""
        return self._waiting > 0

    # -- prompts -------------------------------------------------------------------------------------------

    def point(self, at: Sequence[float], side: Side) -> None:
        """Click a point."""
        voxel = prompts.voxel_of(at, self.shape)
        around = self._grid.box_around(voxel, prompts.POINT)
        self._add([prompts.point(self._grid, voxel, side, self._labels_on(around), around)])

    def rectangle(self, ends: Sequence[Sequence[float]], side: Side) -> None:
        """Bound the object in a slice by a rectangle, or take one away."""
        self._add(prompts.outline(self._grid, prompts.rectangle(ends, self.shape), side))

    def scribble(self, mask: NDArray[Any], box: Sequence[Sequence[int]] | None, side: Side) -> None:
        """Click the voxels of a stroke."""
        self._add([prompts.voxels(mask, box, self.shape, side)])

    def lasso(self, mask: NDArray[Any], box: Sequence[Sequence[int]] | None, side: Side) -> None:
        """Bound the object in a slice by a line around it, or take a part away."""
        self._add(prompts.outline(self._grid, prompts.voxels(mask, box, self.shape, side), side))

    def start_from(self, labels: NDArray[Any]) -> None:
        """Set the object; the client shows these labels already."""
        if labels.shape != self.shape:
            raise InputError(
                f"labels of shape {labels.shape} were sent, expected the image's {self.shape}"
            )
        mask = np.ascontiguousarray(labels.transpose(self._axes)) != 0
        self._object.start_from(mask)
        self._changed, self._waiting = None, 0

    def undo(self) -> bool:
        """Take the last prompt back; return False where there is none."""
        if not self._object.count:
            return False
        self._note(self._object.undo())
        self._waiting += 1
        return True

    def clear(self) -> None:
        """Forget the prompts; the client has cleared its labels already."""
        self._object.clear()
        self._changed, self._waiting = None, 0

    def answer(self) -> Answer | None:
        """Return the part that has changed since the last answer, if any."""
        changed = self._changed
        self._changed = None
        self._waiting = 0
        return None if changed is None else Answer(changed, self._labels_on(changed))

    def _add(self, clicks: Sequence[accelsurf.Click]) -> None:
        turned = [
            accelsurf.Click(
                click.side,
                self._turned(click.box),
                np.ascontiguousarray(click.mask.transpose(self._axes)),
            )
            for click in clicks
        ]
        inside, outside = (
            [click for click in turned if click.side == side] for side in ("inside", "outside")
        )
        self._note(self._object.add(inside, outside))
        self._waiting += 1

    def _note(self, changed: Box | None) -> None:
        """Widen the changed part by a box in our order of axes."""
        if changed is None:
            return
        back = tuple(changed[self._axes.index(axis)] for axis in range(3))
        before = self._changed or back
        n, m, k = (
            slice(min(a.start, b.start), max(a.stop, b.stop))
            for a, b in zip(before, back, strict=True)
        )
        self._changed = n, m, k

    def _turned(self, box: Box) -> Box:
        z, y, x = (box[axis] for axis in self._axes)
        return z, y, x

    def _labels_on(self, box: Box) -> NDArray[np.uint8]:
        """Return labels on a box, both in the client's order of axes."""
        return np.ascontiguousarray(
            self._object.labels_on(self._turned(box)).transpose(np.argsort(self._axes))
        )


class LeaseLostError(Exception):
    """A lease that there is not, or not any more."""


class FullError(Exception):
    """All sessions are taken."""


class Lease:
    """A client's place.

    Parameters
    ----------
    now : float
        Seconds.
    number : int
        Counts the places that were given; says nothing of the token.

    Attributes
    ----------
    number : int
    seen, active : float
        Times of its last request, and of the last one that a person made.
    session : ImageSession or None
        Its image and object; None before it has sent an image.
    """

    def __init__(self, now: float, number: int = 0) -> None:
        self.number = number
        self.seen = self.active = now
        self.session: ImageSession | None = None

    def touch(self, now: float, *, by_person: bool) -> None:
        """Note a request."""
        self.seen = now
        if by_person:
            self.active = now

    def close(self) -> None:
        """Let go of the session."""
        self.session = None

    def open(self, session: ImageSession) -> None:
        """Give the client a session, in place of the one that it has."""
        self.session = session


class Leases:
    """The leases of a server, by their secret token.

    Parameters
    ----------
    most : int
        Greatest number of leases at once.
    idle : float
        Seconds without a prompt after which a lease ends.
    clock : callable, optional
        Returns seconds.
    on_end : callable, optional
        Called with a lease that has ended, and why.
    """

    def __init__(
        self,
        most: int,
        idle: float,
        clock: Callable[[], float] = time.monotonic,
        on_end: Callable[[Lease, str], None] = lambda lease, why: None,
    ) -> None:
        self.most, self.idle = most, idle
        self.clock, self.held, self._on_end = clock, dict[str, Lease](), on_end
        self._count = 0

    def claim(self) -> str:
        """Return the token of a new lease.

        Raises
        ------
        FullError
        """
        self.sweep()
        if len(self.held) >= self.most:
            raise FullError
        token = secrets.token_urlsafe(24)
        self._count += 1
        self.held[token] = Lease(self.clock(), self._count)
        return token

    def peek(self, token: str) -> Lease | None:
        """Return a lease, if there is one; nothing is postponed, and none ends."""
        return self.held.get(token)

    def find(self, token: str, *, by_person: bool = False) -> Lease:
        """Return a lease, which a request has come with; one ``by_person`` postpones its end.

        Raises
        ------
        LeaseLostError
        """
        lease = self._alive(token)
        lease.touch(self.clock(), by_person=by_person)
        return lease

    def remaining(self, token: str) -> float:
        """Return the seconds until a lease ends if no prompt comes; nothing is postponed.

        Raises
        ------
        LeaseLostError
        """
        return max(self.idle - (self.clock() - self._alive(token).active), 0.0)

    def _alive(self, token: str) -> Lease:
        self.sweep()
        lease = self.held.get(token)
        if lease is None:
            raise LeaseLostError
        return lease

    def release(self, token: str, why: str = "") -> None:
        """End a lease, if there is one."""
        lease = self.held.pop(token, None)
        if lease is not None:
            self._ended(lease, why)

    def sweep(self) -> None:
        """End the leases of clients that are gone or idle."""
        now = self.clock()
        for token, lease in list(self.held.items()):
            if now - lease.seen > LIVENESS:
                self.release(token, f"no sign of life for {LIVENESS:g} seconds")
            elif now - lease.active > self.idle:
                self.release(token, f"no prompt for {self.idle:g} seconds")

    def _ended(self, lease: Lease, why: str) -> None:
        lease.close()
        self._on_end(lease, why)
