"""Measurements drawn over slices and surfaces: lines with a dark rim, their ends, their figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D

from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.core.measurements import Measurement
from accelsurf.viewer.scene.colors import MEASURE, RIM
from accelsurf.viewer.scene.overlay import Label, Pixels
from accelsurf.viewer.scene.redraw import Redraw
from accelsurf.viewer.scene.shapes import path_lines
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import SpaceTile

#: Width of a line, of its rim, size of an end, pixels; radius of an arc, of the shorter arm.
LINE, RIM_LINE, END, ARC = 1.6, 4.0, 7.0, 0.3

Floats = NDArray[np.float64]


class Mark(NamedTuple):
    """A measurement in the space of a renderer.

    Attributes
    ----------
    paths : tuple of ndarray (n, 3)
        Its lines; none where only ends are seen.
    ends : ndarray (m, 3)
    text : str
    at : ndarray (3,)
        Where the text begins.
    """

    paths: tuple[Floats, ...]
    ends: Floats
    text: str
    at: Floats


class _Overlay:
    """Lines or points at places of a renderer's space, drawn over its picture."""

    def __init__(self, renderer: pv.Renderer, color: str) -> None:
        self._mapper, self._actor, coordinate = vtkPolyDataMapper2D(), vtkActor2D(), vtkCoordinate()
        coordinate.SetCoordinateSystemToWorld()
        self._mapper.SetTransformCoordinate(coordinate)
        self._actor.SetMapper(self._mapper)
        self._actor.GetProperty().SetColor(pv.Color(color).float_rgb)
        renderer.AddViewProp(self._actor)

    def show(self, mesh: pv.PolyData) -> None:
        self._mapper.SetInputData(mesh)
        self._actor.SetVisibility(mesh.n_points > 0)

    def fit(self, size: float) -> None:
        self._actor.GetProperty().SetLineWidth(size)
        self._actor.GetProperty().SetPointSize(size)


class MeasureMarks:
    """The measurements in one renderer; always above the picture.

    Parameters
    ----------
    renderer : pyvista.Renderer
    """

    def __init__(self, renderer: pv.Renderer) -> None:
        self.renderer = renderer
        self._rim, self._lines, self._ends = (_Overlay(renderer, color) for color in (RIM, MEASURE, MEASURE))
        self._labels: list[Label] = []
        self.show(())

    @property
    def texts(self) -> tuple[str, ...]:
        """The figures that are written."""
        return tuple(label.text for label in self._labels if label.text)

    def show(self, marks: Sequence[Mark]) -> None:
        """Draw these, in place of those before."""
        lines = path_lines([path for mark in marks for path in mark.paths])
        ends = np.concatenate([np.zeros((0, 3)), *(mark.ends for mark in marks)])
        points = pv.PolyData(ends) if len(ends) else pv.PolyData()
        for overlay, mesh in ((self._rim, lines), (self._lines, lines), (self._ends, points)):
            overlay.show(mesh)
        while len(self._labels) < len(marks):
            self._labels.append(Label(self.renderer, MEASURE, (0.0, 0.0, 0.0), boxed=True))
        for label in self._labels[len(marks) :]:
            label.text = ""
        for label, mark in zip(self._labels, marks, strict=False):
            label.text = mark.text
            label.move(*mark.at)

    def fit(self, pixels: Pixels) -> None:
        """Draw lines, ends and text as large as the picture asks for."""
        for overlay, size in ((self._rim, RIM_LINE), (self._lines, LINE), (self._ends, END)):
            overlay.fit(size * pixels.ratio)
        for label in self._labels:
            label.fit(pixels)


class MeasureLayer:
    """The measurements in all tiles of a scene.

    Parameters
    ----------
    geometry : Geometry
        Of the image.
    slices : mapping of str to SliceTile
    space : SpaceTile or None
    unit : str
        Of lengths in the file.
    redraw : Redraw
    """

    def __init__(
        self,
        geometry: Geometry,
        slices: Mapping[str, SliceTile],
        space: SpaceTile | None,
        unit: str,
        redraw: Redraw,
    ) -> None:
        self._geometry, self._slices, self._unit, self._redraw = geometry, dict(slices), unit, redraw
        self.marks = {name: MeasureMarks(tile.renderer) for name, tile in slices.items()}
        if space is not None:
            self.marks["space"] = MeasureMarks(space.renderer)
        self._measurements: tuple[Measurement, ...] = ()

    def show(self, measurements: Iterable[Measurement], dragged_in: str | None = None) -> None:
        """Draw these, in place of those before; while one is dragged in a tile, that tile alone is drawn at once."""
        self._measurements = tuple(measurements)
        self.move()
        drawn = self.marks.values() if dragged_in is None else [self.marks[dragged_in]]
        self._redraw.mark(*(marks.renderer for marks in drawn))

    def move(self) -> None:
        """The slices have moved: draw what is in them now."""
        for name, marks in self.marks.items():
            if name in self._slices:
                marks.show([self._in_slice(measurement, self._slices[name]) for measurement in self._measurements])
            else:
                marks.show([self._in_space(measurement) for measurement in self._measurements])

    def fit(self, pixels: Pixels) -> None:
        """Draw lines, ends and text as large as the picture asks for."""
        for marks in self.marks.values():
            marks.fit(pixels)

    def _in_space(self, measurement: Measurement) -> Mark:
        points = np.asarray(measurement.points, float)
        return _mark(points, measurement.text(self._unit))

    def _in_slice(self, measurement: Measurement, tile: SliceTile) -> Mark:
        """All of one that lies in a slice; else its ends that do, within half a voxel."""
        index = self._geometry.world_to_index(np.asarray(measurement.points, float))
        near = tile.is_near(index)
        places = tile.to_tile(index)
        points = np.column_stack([places, np.full(len(places), 4.0)])
        if near.all():
            return _mark(points, measurement.text(self._unit))
        return Mark((), points[near], "", points[0])


def _mark(points: Floats, text: str) -> Mark:
    """The mark of points (n, 3): the line through them; of three, an arc at the second."""
    if len(points) < 3:
        return Mark((points,) if len(points) > 1 else (), points, text, points[-1])
    arc = _arc(points)
    return Mark((points, *arc), points, text, arc[0][len(arc[0]) // 2] if arc else points[1])


def _arc(points: Floats) -> tuple[Floats, ...]:
    """The arc of an angle; none where an arm has no length."""
    before, after = points[0] - points[1], points[2] - points[1]
    lengths = float(np.linalg.norm(before)), float(np.linalg.norm(after))
    if not min(lengths) > 0:
        return ()
    first, second = before / lengths[0], after / lengths[1]
    across = second - (second @ first) * first
    size = float(np.linalg.norm(across))
    if size < 1e-9:
        return ()
    turn = np.linspace(0.0, np.arctan2(size, second @ first), 25)[:, None]
    return (points[1] + ARC * min(lengths) * (np.cos(turn) * first + np.sin(turn) * across / size),)
