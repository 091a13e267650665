"""Files that a tracking writes: their choice and their names; its table of tracks is read here."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io import functions_of, naming
from accelsurf.output import report_name
from accelsurf.settings import budgets
from accelsurf.settings.file_formats import DEFAULT_IMAGE_FORMAT, IMAGE_FORMATS, label_formats
from accelsurf.settings.mesh_formats import Shape, mesh_formats
from accelsurf.settings.track_fields import TRACK_FORMATS

T = TypeVar("T")


@dataclass(frozen=True)
class TrackFiles:
    """Choice of files beside the tables, the curves, the film strip and the report, which are always written.

    Parameters
    ----------
    labels : str
        Format of the label maps, one of `accelsurf.settings.file_formats.IMAGE_FORMATS`.
    per_frame : bool
        Write a label map for each frame instead of one file with time.
    mesh : tuple of str
        Formats of a surface, or of contours where the frames have one slice, for each object in each frame; none by
        default.
    mesh_space : {"lps", "ras"}
        Coordinates of meshes.
    also : tuple of str
        Further files, from `accelsurf.settings.track_fields.TRACK_FORMATS`.
    """

    labels: str = DEFAULT_IMAGE_FORMAT
    per_frame: bool = False
    mesh: tuple[str, ...] = ()
    mesh_space: Literal["lps", "ras"] = "lps"
    also: tuple[str, ...] = ()

    def check(self, geometry: Geometry) -> None:
        """Refuse files that cannot be written of frames on a grid.

        Raises
        ------
        UsageError
            With the formats that can be written.
        """
        is_2d = geometry.slice_axis is not None
        shape: Shape = "contour" if is_2d else "surface"
        frames = "frames of one slice" if is_2d else "volumes"
        if self.labels not in IMAGE_FORMATS or not IMAGE_FORMATS[self.labels].is_written:
            raise UsageError(
                f"format: {self.labels} was given, expected {', '.join(label_formats())}",
                "nii.gz is the default",
            )
        if not self.per_frame and functions_of(IMAGE_FORMATS[self.labels]).write_frames is None:
            raise UsageError(
                f"format: {self.labels} was given, one file of it holds no time",
                "add --per-frame, or take nii.gz",
            )
        if IMAGE_FORMATS[self.labels].only_2d and geometry.shape[0] > 1:
            raise UsageError(
                f"format: {self.labels} was given for volumes, it holds one slice",
                "take nii.gz or tif",
            )
        for kind in self.mesh:
            if kind not in mesh_formats(shape):
                raise UsageError(
                    f"mesh: {kind} was given for {frames}, expected {', '.join(mesh_formats(shape))}"
                )
        for name in self.also:
            if name not in TRACK_FORMATS:
                raise UsageError(f"also: {name} was given, expected {', '.join(TRACK_FORMATS)}")

    def names(self, name: str) -> dict[str, str]:
        """Name of every file by its kind, without the files of single frames."""
        ends = {
            "tracks": "tracks.csv",
            "curves": "curves.csv",
            "curves-picture": "curves.png",
            "preview": "preview.png",
            "config": "run.toml",
            **{kind: TRACK_FORMATS[kind].ending for kind in self.also},
        }
        files = {kind: f"{name}_{end}" for kind, end in ends.items()} | {
            "report": report_name(name)
        }
        return files if self.per_frame else {"labels": f"{name}_labels.{self.labels}"} | files

    def paths(self, folder: Path, name: str) -> dict[str, Path]:
        """Every possible file by its kind; of the files of single frames, the ones that exist already."""
        paths = {kind: folder / file for kind, file in self.names(name).items()}
        there = folder.iterdir() if folder.is_dir() else ()
        return paths | {path.name: path for path in sorted(there) if is_of_frame(path.name, name)}


def labels_name(name: str, number: str, suffix: str) -> str:
    """Name of the label map of a frame.

    Examples
    --------
    >>> labels_name("cells", "003", "nii.gz")
    'cells_labels_t003.nii.gz'
    """
    return f"{name}_labels_t{number}.{suffix}"


def mesh_name(name: str, shape: str, object_id: int, number: str, suffix: str) -> str:
    """Name of the mesh of an object in a frame; the number of the frame is last: viewers then find a series.

    Examples
    --------
    >>> mesh_name("cells", "surface", 7, "003", "ply")
    'cells_surface_7_t003.ply'
    """
    return f"{name}_{shape}_{object_id}_t{number}.{suffix}"


def is_of_frame(file: str, name: str) -> bool:
    """Test if a file has the name of one of a single frame.

    Examples
    --------
    >>> is_of_frame("cells_surface_7_t003.ply", "cells"), is_of_frame("cells_tracks.csv", "cells")
    (True, False)
    """
    pattern = rf"{re.escape(name)}_(labels|(surface|contour)_[1-9][0-9]*)_t[0-9]{{3,}}\.[a-z0-9.]+"
    return re.fullmatch(pattern, file) is not None


def read_tracks_table(
    path: Path, parse: Callable[[Sequence[str], Iterator[Mapping[str, str]]], T]
) -> T:
    """Read a table of tracks.

    Parameters
    ----------
    path : Path
    parse : callable
        Of the names of the columns and the lines, returns their content.

    Raises
    ------
    InputError
        With the file, the line and the fault in it.
    """
    with naming(path):
        budgets.CASES.check(path.stat().st_size, "the table of tracks")
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.DictReader(file, strict=True)
            try:
                return parse(lines.fieldnames or (), lines)
            except (
                csv.Error,
                ValueError,
                KeyError,
                TypeError,
            ):  # TypeError: a line with fewer cells
                raise InputError(
                    f"line {lines.line_num}: not a line of a table of tracks, whole numbers of frame, id and parent "
                    "expected",
                    "correct it, or write the table again with accelsurf track",
                ) from None
