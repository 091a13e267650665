"""Frames of a tracking on the disk while it goes on: in any order, one file each, read one at a time at the end.

A frame's file is there whole or not at all, so that a tracking that was killed goes on from those that are there.
"""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import OutputError
from accelsurf.grid.boxes import Box, as_corner, bounding_box, box_at, enclosing, placed_at
from accelsurf.grid.geometry import Geometry
from accelsurf.image.grey_window import GreyWindow, window_of
from accelsurf.image.sequence import ImageSequence
from accelsurf.io import label_type, refuse_links
from accelsurf.track.records import FrameResult, Lineage, SurfacePiece, TrackedObject

#: psi is written up to this distance from the surface, in largest voxel sizes: contours need it.
_BAND = 3.0
#: Names in the folder of the frames.
_FRAME = re.compile(r"frame_(\d{6}|[1-9]\d{6,11})\.npz")
_MESHES = "meshes"
_OF_A_STORE = re.compile(rf"{_FRAME.pattern}|\.\d+\.npz|{_MESHES}")
_MESH = re.compile(r".*_(surface|contour)_\d+_t\d{3,}\.[a-z0-9.]+|\..*\.accelsurf")


@dataclass(frozen=True)
class ObjectRow:
    """One object in one frame: the numbers of `accelsurf.track.records.TrackedObject`, of the same names."""

    id: int
    seen: bool
    centroid: tuple[float, float, float]
    velocity: tuple[float, float, float]
    volume_mm3: float
    area_mm2: float
    quality: float

    @classmethod
    def of(cls, tracked: TrackedObject) -> ObjectRow:
        """The numbers of an object, as plain ones."""
        x, y, z = (float(v) for v in tracked.centroid)
        vx, vy, vz = (float(v) for v in tracked.velocity)
        numbers = float(tracked.volume_mm3), float(tracked.area_mm2), float(tracked.quality)
        return cls(int(tracked.id), bool(tracked.seen), (x, y, z), (vx, vy, vz), *numbers)

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> ObjectRow:
        """Read the numbers as they stand in the file of a frame."""
        return cls(
            **{
                **values,
                "centroid": tuple(values["centroid"]),
                "velocity": tuple(values["velocity"]),
            }
        )


@dataclass(frozen=True)
class FrameRow:
    """One frame without its voxels.

    Attributes
    ----------
    frame : int
    time : float
    seconds : float
        Wall time of the frame.
    objects : tuple of ObjectRow
        In order of their ids.
    """

    frame: int
    time: float
    seconds: float
    objects: tuple[ObjectRow, ...]


class DrawnObject(NamedTuple):
    """An object as it is drawn: its id, whether it is seen, its surface, and its prediction."""

    id: int
    seen: bool
    surface: SurfacePiece
    predicted: SurfacePiece | None


def remove_store(folder: Path) -> None:
    """Remove the frames that a tracking has left in a folder, and the folder.

    Raises
    ------
    OutputError
        When it is a link, or there is something else in it: then it is somebody's, and stays as it is.
    """
    refuse_links(folder, "remove the link, or choose another folder with -o")
    try:
        names = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        names = []
    others = sorted(name for name in names if not _is_of_a_store(folder / name))
    if others or (folder.exists() and not folder.is_dir()):
        raise OutputError(
            f"{folder}: is not what a tracking has left{f', {others[0]} is in it' if others else ''}",
            "choose another folder with -o, or move it away",
        )
    shutil.rmtree(folder, ignore_errors=True)


def _is_of_a_store(path: Path) -> bool:
    """Test if a tracking has written a file or folder in the folder of the frames."""
    if path.is_symlink() or _OF_A_STORE.fullmatch(path.name) is None:
        return False
    if path.name == _MESHES:
        return path.is_dir() and all(
            _MESH.fullmatch(inner.name) and inner.is_file() for inner in path.iterdir()
        )
    if path.name.startswith("."):  # a frame that was not complete when the process was killed
        return True
    try:
        with zipfile.ZipFile(path) as archive:
            return "row.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


class FrameStore:
    """Frames in a folder.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    resume : bool
        Whether the frames in it count, those that can be read; else it is emptied.
    read_only : bool
        Whether the folder stays as it is, whatever is in it.
    """

    def __init__(self, folder: Path, resume: bool = True, read_only: bool = False) -> None:
        self.folder = folder
        if read_only:
            return
        refuse_links(folder, "remove the link, or choose another folder with -o")
        if not resume:
            remove_store(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for number in self.numbers():
            try:
                self.frame_row(number)
            except Exception:  # numpy and zipfile raise errors of many kinds about damaged files
                self._path(number).unlink()  # when the machine stopped: it is made again

    def numbers(self) -> list[int]:
        """The frames that are there, rising."""
        found = (
            _FRAME.fullmatch(name)
            for name in (os.listdir(self.folder) if self.folder.is_dir() else ())
        )
        return sorted(int(name[1]) for name in found if name is not None)

    def put(self, result: FrameResult) -> None:
        """Write a frame; one that is there already is replaced.

        Raises
        ------
        OSError
            When it cannot be written.
        """
        arrays: dict[str, NDArray[Any]] = {}
        labels, band = result.labels(), _BAND * max(result.geometry.spacing)
        for tracked in result.objects:
            box = tracked.surface.box
            arrays[f"corner_{tracked.id}"] = np.array([side.start for side in box], np.int64)
            arrays[f"shape_{tracked.id}"] = np.array(tracked.surface.psi.shape, np.int64)
            arrays[f"mask_{tracked.id}"] = np.packbits(labels[box] == tracked.id)
            arrays[f"psi_{tracked.id}"] = _rounded(tracked.surface.psi, band)
            if tracked.predicted is not None:
                arrays[f"predicted_corner_{tracked.id}"] = np.array(
                    tracked.predicted.corner, np.int64
                )
                arrays[f"predicted_{tracked.id}"] = _rounded(tracked.predicted.psi, band)
        rows = tuple(ObjectRow.of(tracked) for tracked in result.objects)
        row = FrameRow(int(result.frame), float(result.time), float(result.seconds), rows)
        arrays["row"] = np.frombuffer(json.dumps(asdict(row)).encode(), np.uint8)
        staged = self.folder / f".{result.frame}.npz"
        staged.unlink(missing_ok=True)  # a link would be followed
        np.savez_compressed(staged, **arrays)  # type: ignore[arg-type]
        os.replace(staged, self._path(result.frame))

    def copy_frame(self, number: int, folder: Path) -> None:
        """Write a frame into another folder, without its duration.

        Raises
        ------
        OSError
            When it cannot be written.
        """
        with self._opened(number) as arrays:
            found = dict(arrays)
        row = replace(_row_of(found), seconds=0.0)
        found["row"] = np.frombuffer(json.dumps(asdict(row)).encode(), np.uint8)
        np.savez_compressed(folder / self._path(number).name, **found)

    def frame_row(self, number: int) -> FrameRow:
        """The numbers of a frame."""
        with self._opened(number) as arrays:
            return _row_of(arrays)

    def labels(self, number: int, geometry: Geometry, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Label map (nz, ny, nx) of a frame: the ids of the objects that it shows."""
        labels = np.zeros(geometry.shape, dtype)
        with self._opened(number) as arrays:
            for row in _row_of(arrays).objects:
                if row.seen:
                    labels[_box(arrays, row.id)][_mask(arrays, row.id)] = row.id
        return labels

    def shown(self, number: int) -> list[int]:
        """The ids in the label map of a frame."""
        with self._opened(number) as arrays:
            return [
                row.id
                for row in _row_of(arrays).objects
                if row.seen and arrays[f"mask_{row.id}"].any()
            ]

    def drawn(self, number: int) -> list[DrawnObject]:
        """Return the objects of a frame as they are drawn; psi is exact to 1/1000, and flat far from the surface."""
        found = []
        with self._opened(number) as arrays:
            for row in _row_of(arrays).objects:
                psi = arrays[f"psi_{row.id}"].astype(np.float32)
                surface = SurfacePiece(as_corner(arrays[f"corner_{row.id}"]), psi)
                predicted = None
                if f"predicted_{row.id}" in arrays:
                    corner = as_corner(arrays[f"predicted_corner_{row.id}"])
                    psi = arrays[f"predicted_{row.id}"].astype(np.float32)
                    predicted = SurfacePiece(corner, psi)
                found.append(DrawnObject(row.id, row.seen, surface, predicted))
        return found

    def _path(self, number: int) -> Path:
        return self.folder / f"frame_{number:06d}.npz"

    def _opened(self, number: int) -> Any:
        return np.load(self._path(number), allow_pickle=False)


@dataclass(frozen=True, eq=False)
class TrackSet:
    """All that files of tracks are written from.

    Attributes
    ----------
    name : str
        First part of the names of files.
    sequence : ImageSequence
    rows : tuple of FrameRow
        Rising; frames that the tracking has not reached lack.
    lineage : Lineage
    store : FrameStore
        Voxels of a frame, when they are asked for.
    """

    name: str
    sequence: ImageSequence
    rows: tuple[FrameRow, ...]
    lineage: Lineage
    store: FrameStore

    @property
    def geometry(self) -> Geometry:
        """Grid of every frame."""
        return self.sequence.geometry

    @cached_property
    def unit(self) -> str:
        """Unit in which lengths are shown: that of the first frame, as headers of sequences give their grid in mm."""
        return self.sequence.frame(self.rows[0].frame).geometry.unit if self.rows else "mm"

    @property
    def label_type(self) -> np.dtype[Any]:
        """Type of the label maps of all frames."""
        return label_type(
            max((tracked.id for row in self.rows for tracked in row.objects), default=0)
        )

    def labels(self, number: int) -> NDArray[Any]:
        """Label map (nz, ny, nx) of a frame; 0 in one that the tracking has not reached."""
        if any(row.frame == number for row in self.rows):
            return self.store.labels(number, self.geometry, self.label_type)
        return np.zeros(self.geometry.shape, self.label_type)

    def frames_shown(self) -> dict[int, list[int]]:
        """Return the frames whose label map has a voxel of an object, rising, by its id."""
        frames: dict[int, list[int]] = {}
        for row in self.rows:
            for object_id in self.store.shown(row.frame):
                frames.setdefault(object_id, []).append(row.frame)
        return frames

    @cached_property
    def by_object(self) -> dict[int, list[tuple[FrameRow, ObjectRow]]]:
        """Frames in which an object is seen or predicted, rising, by its id."""
        found: dict[int, list[tuple[FrameRow, ObjectRow]]] = {}
        for row in self.rows:
            for tracked in row.objects:
                found.setdefault(tracked.id, []).append((row, tracked))
        return dict(sorted(found.items()))

    @cached_property
    def extent(self) -> Box | None:
        """Voxels around all objects in all frames and around their predictions, None where there is none.

        All pictures show this part. Each frame is read, one at a time, when the first picture asks.
        """
        boxes = [
            box
            for row in self.rows
            for drawn in self.store.drawn(row.frame)
            for box in _inside_boxes(drawn)
        ]
        return functools.reduce(enclosing, boxes) if boxes else None

    @cached_property
    def window(self) -> GreyWindow:
        """Grey values of all pictures: selected on the first frame, with its objects."""
        if not self.rows:
            return GreyWindow(0.0, 1.0)
        first = self.rows[0].frame
        inside = self.labels(first) > 0
        array = self.sequence.frame(first).array
        return window_of(array, inside) if inside.any() else window_of(array)


def _inside_boxes(drawn: DrawnObject) -> Iterator[Box]:
    """Voxels of an object in a frame, and of its prediction."""
    for piece in (drawn.surface, drawn.predicted):
        box = None if piece is None else bounding_box(piece.psi < 0)
        if piece is not None and box is not None:
            yield placed_at(box, piece.corner)


def frame_digits(count: int) -> int:
    """Digits of the numbers of ``count`` frames in names of files: three, or more for longer sequences.

    Examples
    --------
    >>> frame_digits(30), frame_digits(1001)
    (3, 4)
    """
    return max(3, len(str(count - 1)))


def _rounded(psi: NDArray[np.float32], band: float) -> NDArray[np.float16]:
    return np.clip(psi, -band, band).astype(np.float16)


def _row_of(arrays: Mapping[str, NDArray[Any]]) -> FrameRow:
    found = json.loads(arrays["row"].tobytes())
    objects = tuple(ObjectRow.read(values) for values in found["objects"])
    return FrameRow(found["frame"], found["time"], found["seconds"], objects)


def _box(arrays: Mapping[str, NDArray[Any]], object_id: int) -> Box:
    corner, shape = (as_corner(arrays[f"{name}_{object_id}"]) for name in ("corner", "shape"))
    return box_at(corner, shape)


def _mask(arrays: Mapping[str, NDArray[Any]], object_id: int) -> NDArray[np.bool_]:
    shape = as_corner(arrays[f"shape_{object_id}"])
    return (
        np.unpackbits(arrays[f"mask_{object_id}"], count=int(np.prod(shape)))
        .reshape(shape)
        .view(np.bool_)
    )
