"""When nothing has happened for some time, the picture is drawn in full: all triangles, smooth edges.

Until then it is drawn so that mouse and keys are answered at once. A processor that draws needs three times as long for
smooth edges, and as long again to begin without them: with a tool in hand they are left out there.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from accelsurf.viewer.scene.headless import draws_in_software
from accelsurf.viewer.workplace.mouse import MouseFeature

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.workplace import Workplace

#: Seconds without a change after which the picture is drawn in full.
DELAY = 0.4


class Quiet:
    """Draws in full when it is quiet.

    Parameters
    ----------
    workplace : Workplace
    """

    def __init__(self, workplace: Workplace) -> None:
        self._workplace, self._since, self._is_full = workplace, time.perf_counter(), True
        self._is_software: bool | None = None

    @property
    def is_software(self) -> bool:
        """Whether the processor draws, not a graphics card."""
        if self._is_software is None:
            self._is_software = draws_in_software(self._workplace.scene.plotter.render_window)
        return self._is_software

    def touch(self) -> None:
        """Something has changed, and is to be drawn as fast as possible."""
        self._since, self._is_full = time.perf_counter(), False
        if self.is_software:
            self._workplace.scene.tiles.smooth_edges(False)

    def draw_in_full(self) -> bool:
        """Draw all triangles and smooth edges, once nothing has happened for some time; returns whether it is time."""
        if self._is_full or time.perf_counter() - self._since < DELAY or self._is_busy():
            return False
        scene, self._is_full = self._workplace.scene, True
        changed = scene.tiles.coarsen(False)
        if not self.is_software or self._workplace.feature(MouseFeature).tool.name == "look":
            changed |= scene.tiles.smooth_edges(True)
        if changed:
            scene.render()
        return True

    def _is_busy(self) -> bool:
        return self._workplace.session.status.playing or self._workplace.feature(MouseFeature).is_dragging
