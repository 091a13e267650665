"""Measures: distances and angles that a person draws, and mesh statistics of the objects."""

from __future__ import annotations

import csv
import functools
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelsurf.errors import UsageError
from accelsurf.io.files import write_bytes
from accelsurf.measure.diameters import Diameters
from accelsurf.output import folder as output_folder
from accelsurf.output.tables import csv_text
from accelsurf.settings.corrections import MAX_ID
from accelsurf.settings.wording import in_unit, size_text
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.tool import AllActions, Feature, Tool, whole
from accelsurf.viewer.core.measurements import COLUMNS, Measurement, Measurements
from accelsurf.viewer.core.status import Status, View
from accelsurf.viewer.scene.legend import measure
from accelsurf.viewer.scene.space import Picked

if TYPE_CHECKING:
    from accelsurf.viewer.core.measurements import Figures


#: An end is grabbed from so many pixels away, of a usual screen.
GRAB = 9.0
#: A press that has moved by no more is a click.
CLICK = 2.0


class Distance(Tool):
    """Draws a line from a press to a release, or from click to click; its ends can be dragged."""

    name, key, text = "distance", "D", "Length"
    tip = "Drag from one end to the other, or click both; drag an end to move it"

    def __init__(self, actions: AllActions, measurements: Measurements) -> None:
        super().__init__(actions)
        self._measurements = measurements
        #: Number of the measurement, and its end, that moves with the mouse.
        self._held: tuple[int, int] | None = None
        self._unfinished: int | None = None
        #: Takes back what the last press has done, until the button is up.
        self._restore: Callable[[], None] | None = None
        self._pixel_mm = 0.0

    def press(self, at: Picked) -> None:
        if at.world is None:
            return
        known = self._measurements
        tiles = self.actions.scene.tiles
        self._pixel_mm = tiles.pixel_ratio * tiles.tile(at.tile).mm_per_pixel()
        near = known.nearest(at.world, GRAB * self._pixel_mm)
        if self._unfinished is not None and near != (self._unfinished, len(known[self._unfinished].points) - 1):
            known.add_point(self._unfinished, at.world)
            self._restore = functools.partial(known.shorten, self._unfinished)
            self._held = self._unfinished, len(known[self._unfinished].points) - 1
        elif near is not None:
            self._held = near
            self._restore = functools.partial(known.move, *near, known[near[0]].points[near[1]])
        else:
            drawn = known.add(self.name, [at.world, at.world])
            self._held, self._unfinished, self._restore = (drawn.number, 1), drawn.number, self.forget
        self._show()

    def move(self, at: Picked) -> None:
        if self._held is not None and at.world is not None:
            self._measurements.move(*self._held, at.world)
            self._show(at.tile)

    def release(self) -> None:
        held, self._held, self._restore = self._held, None, None
        if held is not None and held[0] == self._unfinished:
            self._finish(held[0])
        self._show()

    def _finish(self, number: int) -> None:
        """End a press: a click alone waits for its second point; a measurement with all its points is finished."""
        drawn = self._measurements[number]
        if len(drawn.points) == 2 and np.linalg.norm(np.subtract(*drawn.points)) <= CLICK * self._pixel_mm:
            self._measurements.shorten(drawn.number)  # a click: the next one is the second point
        elif drawn.is_complete:
            self._unfinished = None

    def cancel(self) -> None:
        """Take back this press; points that were clicked before stay."""
        restore, self._restore, self._held = self._restore, None, None
        if restore is not None:
            restore()
        self._show()

    def leave(self) -> None:
        """Another tool is used: what has not all its points is forgotten."""
        self.forget()
        self._show()

    def forget(self) -> None:
        """Let go of what is held, and delete what is unfinished."""
        if self._unfinished is not None and self._unfinished in self._measurements:
            self._measurements.delete(self._unfinished)
        self._held = self._unfinished = self._restore = None

    def _show(self, dragged_in: str | None = None) -> None:
        self.actions.scene.measures.show(self._measurements, dragged_in)


class Angle(Distance):
    """Draws two arms: a drag along the first to the corner, then a press or a drag at the end of the second."""

    name, key, text = "angle", "J", "Angle"
    tip = "Drag (or click twice) from an end to the corner, then press at the other end"


class MeasureFeature(Feature):
    """Distances and angles, and the table of the objects.

    Attributes
    ----------
    measurements : Measurements
    figures : Figures or None
        Of the state for which they were asked last.
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self.measurements = Measurements()
        self.figures: Figures | None = None
        self._tools = Distance(actions, self.measurements), Angle(actions, self.measurements)
        self._is_measuring, self._is_current = False, False
        self._lines: list[list[str]] = []
        #: The tables as they are copied, and what they are of.
        self._as_tabs = ""
        self._tabbed_of: tuple[Figures | None, tuple[Measurement, ...]] = (None, ())
        self._written: set[Path] = set()

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "measure_table": self._measure,
            "measure_diameters": self._draw_diameters,
            "measure_delete": self._delete,
            "measure_clear": self._clear,
            "measure_copy": self._copy,
            "measure_save": self._save,
        }

    def tools(self) -> Sequence[Tool]:
        return self._tools

    def state(self, status: Status) -> dict[str, Any]:
        unit = self.actions.scene.unit
        figures = self.figures
        return {
            "measurements": [[drawn.number, drawn.kind, drawn.text(unit)] for drawn in self.measurements],
            "figures": self._lines,
            "figures_ids": [] if figures is None else [row["id"] for row in figures.rows],
            "figures_step": -1 if figures is None else figures.step,
            "figures_current": self._is_current, "measuring": self._is_measuring, "tables": self._tabbed(),
        }

    def update(self, view: View) -> None:
        # Another state is shown: the table is about an earlier one.
        self._is_current = self._is_current and self.figures is not None and view.status.step == self.figures.step

    # -- the table ----------------------------------------------------------------------------------------

    def _measure(self) -> None:
        if self._is_measuring:
            return
        future = self.actions.session.figures()
        self._is_measuring = True
        future.add_done_callback(lambda _: setattr(self, "_is_measuring", False))
        self.actions.ask(future, self._show_figures)

    def _show_figures(self, figures: Figures) -> None:
        self.figures, self._is_current = figures, True
        self._lines = table_of(figures, self.actions.scene.unit, self._thickness())
        if not figures.rows:
            self.actions.note("there is no object to measure")

    def _thickness(self) -> float | None:
        geometry = self.actions.scene.geometry
        return None if geometry.slice_axis is None else float(geometry.spacing[geometry.slice_axis])

    def _draw_diameters(self, object_id: Any = None) -> None:
        known = self.actions.session.status.objects or (1,)
        wanted = whole(object_id, 0, MAX_ID) if object_id is not None else self.actions.object_id or known[0]
        if wanted not in known:
            raise UsageError(f"object {wanted} was named, expected {', '.join(map(str, known))}")
        self.actions.ask(self.actions.session.diameters(wanted), self._show_diameters)

    def _show_diameters(self, lines: Diameters) -> None:
        for ends in lines:
            self.measurements.add("distance", list(ends))
        self.actions.scene.cursor = lines.axial.mean(axis=0)  # to the slice in which two of them lie
        self._show()

    # -- what is drawn ------------------------------------------------------------------------------------

    def _delete(self, number: Any) -> None:
        self.measurements.delete(whole(number, 0, 10**9))
        self._show()

    def _clear(self) -> None:
        self.measurements.clear()
        self._show()

    def _show(self) -> None:
        for tool in self._tools:
            tool.forget()
        self.actions.scene.measures.show(self.measurements)

    # -- out of the program -------------------------------------------------------------------------------

    def _texts(self) -> dict[str, str]:
        """The tables that there are, as CSV, by the last part of their files' names."""
        rows = self.measurements.rows()
        texts = {} if self.figures is None else {"figures.csv": self.figures.csv}
        return texts | ({"measurements.csv": csv_text(COLUMNS, [list(row.values()) for row in rows])} if rows else {})

    def _tabbed(self) -> str:
        """The tables as they are copied; made anew when something was measured."""
        now = self.figures, tuple(self.measurements)
        if now != self._tabbed_of:
            self._tabbed_of, self._as_tabs = now, "\n".join(tabbed(text) for text in self._texts().values())
        return self._as_tabs

    def _copy(self) -> None:
        if not self._tabbed():
            raise UsageError("nothing has been measured", "press Measure, or draw a length")
        self.actions.copy(self._tabbed())
        self.actions.note("copied the tables, with tabs between the columns")

    def _save(self) -> None:
        actions = self.actions
        if actions.folder is None:
            raise UsageError("save: there is no folder to save in", "name one, or save the run first")
        if not self._texts():
            raise UsageError("nothing has been measured", "press Measure, or draw a length")
        written = self._write(actions.folder, self._texts())
        actions.feature(FilesFeature).add(*written)
        actions.note(f"saved in {actions.folder.absolute()}: {', '.join(path.name for path in written)}", 20)

    def save_beside(self, folder: Path) -> list[Path]:
        # The figures of the objects are among the files of the run already.
        return self._write(folder, {name: text for name, text in self._texts().items() if name != "figures.csv"})

    def _write(self, folder: Path, texts: Mapping[str, str]) -> list[Path]:
        paths = {folder / f"{self.actions.session.name}_{name}": text for name, text in texts.items()}
        others = {path.name: path for path in paths if path not in self._written}
        output_folder.refuse_existing(others, self.actions.overwrite)
        output_folder.refuse_existing({path.name: path for path in paths}, overwrite=True)
        for path, text in paths.items():
            write_bytes(path, text.encode())
            self._written.add(path)
        return list(paths)


def table_of(figures: Figures, unit: str, thickness_mm: float | None) -> list[list[str]]:
    """Return the lines of the table: what it is, and the text for each object; the names of the objects first.

    Parameters
    ----------
    figures : Figures
    unit : str
        Of lengths in the file.
    thickness_mm : float or None
        Of an image of one slice, whose objects have an area and an outline.
    """
    if not figures.rows:
        return []
    columns = [_cells(row, unit, thickness_mm, figures.value_unit) for row in figures.rows]
    return [["", *(str(row["name"]) for row in figures.rows)]] + [
        [name, *(column[name] for column in columns)] for name in columns[0]
    ]


def _cells(row: Mapping[str, Any], unit: str, thickness_mm: float | None, value_unit: str) -> dict[str, str]:
    """The texts of an object."""
    cells = {}
    if thickness_mm is not None:
        cells["Area"] = _grouped(row["volume_mm3"] / thickness_mm, unit, 2)
        cells["Outline"] = size_text(row["area_mm2"] / thickness_mm, unit, digits=4)
    else:
        if unit == "mm":
            cells["Volume"] = f"{row['volume_ml']:.4g} ml"
        cells[f"Volume, {unit}3"] = _grouped(row["volume_mm3"], unit, 3)
        cells["Surface"] = _grouped(row["area_mm2"], unit, 2)
    cells["Mean, SD"] = f"{row['mean']:.4g}, {row['sd']:.3g} {value_unit}".rstrip()
    cells["Diameter"] = size_text(row["diameter_mm"], unit, digits=4)
    cells["Across it"] = size_text(row["diameter_across_mm"], unit, digits=4)
    if thickness_mm is None:
        cells["Axial, long"] = size_text(row["diameter_axial_mm"], unit, digits=4)
        cells["Axial, short"] = size_text(row["diameter_axial_across_mm"], unit, digits=4)
    middle = np.asarray(row["centroid_mm"])
    cells["Centroid"] = ", ".join(f"{in_unit(part, unit):.4g}" for part in middle) + f" {unit}"
    return cells


def _grouped(mm: float, unit: str, power: int) -> str:
    """An area or a volume, its digits in groups of three."""
    return f"{measure(in_unit(mm, unit, power))} {unit}{power}"


def tabbed(text: str) -> str:
    """Return a table as CSV with tabs between the columns, as spreadsheets take it from a clipboard.

    Examples
    --------
    >>> tabbed('a,"b, c"').split(chr(9))[0]
    'a'
    """
    return "".join("\t".join(cell.replace("\t", " ") for cell in row) + "\n" for row in csv.reader(io.StringIO(text)))
