"""Where a surface grew fastest in the last part of its run: the first place to look at for a leak.

An observer of the run: it reads the speeds of each step, and changes nothing.
"""

from __future__ import annotations

from collections import defaultdict, deque

import numpy as np
from numpy.typing import NDArray

from accelsurf.evolution.records import Step
from accelsurf.grid.boxes import Corner

#: The last part of a run: so much of its steps on the finest grid.
LAST_SHARE = 0.25
#: Growth is summed over cubes of so many voxels, larger than single bumps of noise.
BLOCK = 6
#: Steps whose growth is stored at most, the last ones.
MAX_STEPS = 400


class LateGrowth:
    """Sums up growth, step by step.

    Parameters
    ----------
    shape : (nz, ny, nx)
        Of the image.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self._shape = shape
        self._blocks = tuple(-(-n // BLOCK) for n in shape)
        self._growth: defaultdict[int, deque[tuple[NDArray[np.int64], NDArray[np.float64]]]] = defaultdict(
            lambda: deque(maxlen=MAX_STEPS)
        )

    def watch(self, step: Step, first: Corner) -> None:
        """Read the growth of a step on the finest grid.

        Parameters
        ----------
        step : Step
        first : (int, int, int)
            Index (z, y, x) in the image of the first voxel of the surface's grid.
        """
        fields = step.fields
        if fields is None or step.record.level or not fields.cells.size:
            return
        # The speed is along the inward normal: below 0 the surface grows.
        motion = np.clip(-fields.speed * np.float32(step.record.dt), 0.0, None)
        grown = np.flatnonzero(motion > 0)
        places = np.unravel_index(fields.cells[grown], step.surface.shape)
        z, y, x = ((at + corner) // BLOCK for at, corner in zip(places, first, strict=True))
        block = np.ravel_multi_index((z, y, x), self._blocks)
        names, place = np.unique(block, return_inverse=True)
        self._growth[step.object_id].append((names, np.bincount(place, motion[grown], len(names))))

    def place(self, object_id: int | None = None) -> tuple[float, float, float] | None:
        """Index (z, y, x) of the middle of the cube that grew most in the last part; None when nothing was seen.

        Parameters
        ----------
        object_id : int, optional
            Of the object; of all unless given.
        """
        total: defaultdict[int, float] = defaultdict(float)
        for own, growth in self._growth.items():
            if object_id not in (None, own):
                continue
            first = len(growth) - max(1, round(LAST_SHARE * len(growth)))
            for names, sums in list(growth)[first:]:
                for name, value in zip(names.tolist(), sums.tolist(), strict=True):
                    total[name] += value
        if not total or max(total.values()) <= 0:
            return None
        largest = max(sorted(total), key=lambda name: total[name])
        z, y, x = np.unravel_index(largest, self._blocks)
        middle = [
            min(int(at) * BLOCK + 0.5 * (BLOCK - 1), n - 1.0) for at, n in zip((z, y, x), self._shape, strict=True)
        ]
        return middle[0], middle[1], middle[2]
