"""What a picture of a run shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry

if TYPE_CHECKING:
    from accelsurf.analysis.surface_mesh import Surface
    from accelsurf.evolution.records import StepRecord


@dataclass(frozen=True, eq=False)
class PreviewContent:
    """What a picture of one run shows.

    Attributes
    ----------
    image : ndarray, shape (nz, ny, nx)
        The image.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm, negative inside.
    geometry : Geometry
        Their grid.
    history : sequence of StepRecord
        One record per step.
    surface : Surface or None
        The surface in world mm; None when there is none (vanished or filled).
    title : str
        One line above the picture.
    anatomical : bool
        Whether the world axes are known to be a patient's, so that letters (R L A P I S) may be written.
    reference : ndarray, shape (nz, ny, nx), optional
        Labels to compare with (> 0 is the object), drawn as a second contour.
    start : ndarray, shape (nz, ny, nx), optional
        psi of the start, drawn for an image of one slice.
    labels : ndarray, shape (nz, ny, nx), optional
        Labels of several objects, drawn instead of psi: psi has no boundary where they touch.
    """

    image: NDArray[Any]
    psi: NDArray[Any]
    geometry: Geometry
    history: Sequence[StepRecord]
    surface: Surface | None
    title: str
    anatomical: bool = False
    reference: NDArray[Any] | None = None
    start: NDArray[Any] | None = None
    labels: NDArray[Any] | None = None
