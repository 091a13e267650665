"""Content of a picture of a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, as_corner, corner_of
from accelsurf.grid.clicks import Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.image.grey_window import GreyWindow
from accelsurf.output.pictures.canvas import object_color
from accelsurf.settings.labels import LabelEntry, LabelTable

if TYPE_CHECKING:
    from accelsurf.evolution import StepRecord


#: The label of the one object of a run without ids.
ONE_LABEL = 1


class ObjectShape(NamedTuple):
    """One of several objects: its id, its part of the grid, and psi there (mm, negative inside)."""

    id: int
    box: Box
    psi: NDArray[Any]


class ClickMark(NamedTuple):
    """A click as it is drawn.

    Attributes
    ----------
    side : {"inside", "outside"}
    id : int
        The object; 1 where there is one alone, 0 for "no object".
    place : (int, int, int)
        The voxel (z, y, x) of its mark: of those clicked the nearest to their middle.
    box : tuple of slice
        Its part of the grid.
    mask : ndarray of bool
        The voxels, of the shape of the box.
    """

    side: Side
    id: int
    place: tuple[int, int, int]
    box: Box
    mask: NDArray[np.bool_]


def marks_of(clicks: Iterable[Click], spacing: Sequence[float]) -> tuple[ClickMark, ...]:
    """Return where clicks are drawn.

    Parameters
    ----------
    clicks : iterable of Click
    spacing : sequence of float
        (hz, hy, hx) in mm.
    """
    marks = []
    for click in clicks:
        voxels = np.argwhere(click.mask)
        distances = (((voxels - voxels.mean(axis=0)) * np.asarray(spacing)) ** 2).sum(axis=1)
        place = as_corner(voxels[np.argmin(distances)] + corner_of(click.box))
        marks.append(ClickMark(click.side, click.id, place, click.box, click.mask))
    return tuple(marks)


@dataclass(frozen=True, eq=False)
class PreviewContent:
    """Content of a picture of one run.

    Attributes
    ----------
    image : ndarray, shape (nz, ny, nx)
        The image, in its own units.
    psi : ndarray, shape (nz, ny, nx)
        Level-set function, mm, negative inside.
    geometry : Geometry
        Their grid.
    history : sequence of StepRecord
        One record per step.
    title : str
        One line above the picture.
    anatomical : bool
        Whether the world axes are known to be a patient's, so that letters (R L A P I S) may be written.
    start : ndarray, shape (nz, ny, nx), optional
        psi of the start, drawn for an image of one slice.
    objects : sequence of ObjectShape
        Several objects with ids, drawn instead of psi, which has no boundary where they touch.
    clicks : sequence of ClickMark
        In the order given.
    late_growth : (float, float, float), optional
        Index (z, y, x) of the place where the surface grew fastest in the last part of the run.
    next_clicks : sequence of (float, float, float)
        Indices (z, y, x) of the places to click next, the most uncertain object's first.
    steps_left_out : int
        Steps of corrections, whose energies compare with no others and are not in ``history``.
    window : GreyWindow, optional
        Values that are black and white; from the object and its surroundings unless given.
    unit : str
        Of lengths in the file, in which scale bars are; places are in mm, as settings take them.
    labels : LabelTable
        Names and colours that were given; other objects have a colour by their place among the ids.
    """

    image: NDArray[Any]
    psi: NDArray[Any]
    geometry: Geometry
    history: Sequence[StepRecord]
    title: str
    anatomical: bool = False
    start: NDArray[Any] | None = None
    objects: Sequence[ObjectShape] = ()
    clicks: Sequence[ClickMark] = ()
    late_growth: tuple[float, float, float] | None = None
    next_clicks: Sequence[tuple[float, float, float]] = ()
    steps_left_out: int = 0
    window: GreyWindow | None = None
    unit: str = "mm"
    labels: LabelTable = field(default_factory=LabelTable)

    def color(self, position: int = 0) -> str:
        """The colour of the object at a place in ``objects``, or of the one without an id."""
        said = self._said(position)
        return object_color(position) if said is None else said.hex

    def name(self, position: int = 0) -> str:
        """The name that was given to the object at a place; empty without one."""
        said = self._said(position)
        return "" if said is None else said.name

    def _said(self, position: int) -> LabelEntry | None:
        return self.labels.entries.get(self.objects[position].id if self.objects else ONE_LABEL)

    def inside(self) -> NDArray[np.bool_]:
        """Voxels in any object, (nz, ny, nx)."""
        return np.asarray(self.psi < 0)
