"""Values that belong to one object of a run: the energy made for it, and its state between two steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.evolution.state import Checkpoint
from accelsurf.grid.boxes import Corner
from accelsurf.segmentation.image_context import ImageContext


class MadeEnergy(NamedTuple):
    """An energy with its ``name`` and the ``terms`` that it is made of, with every setting resolved."""

    energy: Energy
    name: str
    terms: list[dict[str, Any]]


#: Makes the energy of (image, spacing, context).
EnergyMaker = Callable[[NDArray[np.float32], tuple[float, float, float], ImageContext], MadeEnergy]


class ObjectCheckpoint(NamedTuple):
    """An object between two steps: first voxel and shape of its grid, and its evolution there; how often it has moved
    again on its level.
    """

    corner: Corner
    shape: tuple[int, int, int]
    leaked: bool
    evolution: Checkpoint
    reactivations: int = 0

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes."""
        return self.evolution.nbytes
