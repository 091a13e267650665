"""The force of the image, shown over the slices on request: where the surface would grow, where it would shrink."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.image.slice_stack import SliceStack
from accelsurf.viewer.actions.tool import AllActions, Feature, Key
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.scene.force_overlay import ForceOverlay, ForceSlice

if TYPE_CHECKING:
    from accelsurf.run.run import Run

#: Seconds from one picture to the next while the run goes on: its steps are more important.
PAUSE_SECONDS = 1.0


class ForceFeature(Feature):
    """Asks the session for the force in the slices that are shown, whenever one of them or the run has changed.

    Attributes
    ----------
    overlay : ForceOverlay
    is_on : bool
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self.overlay, self.is_on = ForceOverlay(actions.scene), False
        self._waiting: Future[Any] | None = None
        #: Of what run and in which slices the forces are that are known.
        self._run: tuple[Any, ...] = ()
        self._planes: dict[str, tuple[bool, int]] = {}
        self._asked_at = 0.0
        self._note = ""

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"force": lambda on: self._switch(bool(on)), "next_force": lambda: self._switch(not self.is_on)}

    def keys(self) -> Mapping[str, Key]:
        return {"F": Key("next_force", (), "the force of the image over the slices")}

    def state(self, status: Status) -> dict[str, Any]:
        if self.is_on:
            self._ask(status)
        return {"force": self.is_on, "force_note": self._note}

    def _switch(self, on: bool) -> None:
        self.is_on, self._run, self._note = on, (), ""
        if not on:
            self.overlay.show({})

    def _ask(self, status: Status) -> None:
        """Ask for the forces of the present slices, unless they are known or have been asked for."""
        is_early = status.playing and time.monotonic() - self._asked_at < PAUSE_SECONDS
        if not status.ready or self._waiting is not None or is_early:
            return
        whose = self.actions.object_id
        run = (whose, status.step, status.settings, status.undoable, status.redoable, status.playing)
        is_same = run == self._run
        tiles = self.actions.scene.slice_tiles
        planes = {name: tile.sight for name, tile in tiles.items()}
        wanted = {name: at for name, at in planes.items() if not is_same or self._planes.get(name) != at}
        if not wanted:
            return
        self._run, self._planes, self._asked_at = run, planes, time.monotonic()
        measured = is_same and not status.playing
        cuts = [(tiles[name].stack, number) for name, (_, number) in wanted.items()]
        future = self.actions.session.look(lambda run: _forces(run, cuts, whose, measured))
        self._waiting = future
        self.actions.ask(future, lambda forces: self._show(wanted, forces, is_same), keeps_message=True)
        future.add_done_callback(lambda _: setattr(self, "_waiting", None))

    def _show(
        self, planes: Mapping[str, tuple[bool, int]], forces: list[NDArray[np.float32]] | None, is_same: bool
    ) -> None:
        if not self.is_on:
            return
        slices = {} if forces is None else dict(zip(planes, forces, strict=True))
        shown = {name: ForceSlice(planes[name], values) for name, values in slices.items()}
        (self.overlay.add if is_same else self.overlay.show)(shown)
        scale = f"full colour at {self.overlay.scale:.3g}"
        self._note = f"purple grows, orange shrinks, {scale}" if slices else "this energy does not tell its force"


def _forces(
    run: Run, cuts: list[tuple[SliceStack, int]], object_id: int | None, is_measured: bool
) -> list[NDArray[np.float32]] | None:
    """The forces in slices, as `ForceSlice` has them; in the session's thread, which has loaded what computes them, as
    this module is loaded before.
    """
    from accelsurf.run.image_force import image_forces

    planes = [
        voxels_at(stack, number) if stack.is_straight else (stack.axis, number) for stack, number in cuts
    ]
    forces = image_forces(run, planes, object_id, is_measured)
    if forces is None:
        return None
    return [
        force if stack.is_straight else stack.hung(force) for (stack, _), force in zip(cuts, forces, strict=True)
    ]


def voxels_at(stack: SliceStack, number: int) -> NDArray[np.int64]:
    """Index (z, y, x) of the voxel at each pixel of a straight slice, (rows, columns, 3); may be beyond the image."""
    return np.stack(np.broadcast_arrays(*(np.rint(at).astype(np.int64) for at in stack.patch(number).places)), axis=-1)
