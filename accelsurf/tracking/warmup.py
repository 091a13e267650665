"""Every kernel compiled and stored before it is needed: the small runs on images, and small trackings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from accelsurf.grid.sequence import VolumeSequence
from accelsurf.grid.volume import Volume
from accelsurf.segmentation import warmup
from accelsurf.settings.track_config import TrackConfig
from accelsurf.tracking.track import Tracking

#: Voxels along each axis, and the radius of the ball that moves.
SIDE, RADIUS = 24, 6.0


def small_runs() -> dict[str, Callable[[], Any]]:
    """Runs by name, that together call every kernel of surfaces."""
    return {
        **warmup.small_runs(),
        "tracking": lambda: _tracked("flowable-mass"),
        "tracking by constant density": lambda: _tracked("constant-density"),
    }


def _tracked(model: str) -> None:
    """A ball through three frames, with a mesh that is moved along, the way of the observer gone in part."""
    frames = [_frame(x) for x in (-1.0, 0.0, 1.0)]
    start = frames[0].with_array((frames[0].array > 0.5).astype(np.uint8))
    config = TrackConfig(model=model, observer="0.7,0.5", levels=1, max_steps=12)
    for _ in Tracking(VolumeSequence(frames), config, objects=start, meshes=True):
        pass


def _frame(shift: float) -> Volume:
    z, y, x = np.indices((SIDE, SIDE, SIDE)) - SIDE / 2
    return Volume.from_array((z**2 + y**2 + (x - shift) ** 2 < RADIUS**2).astype(np.float32), 1.0)
