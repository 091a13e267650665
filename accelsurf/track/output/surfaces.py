"""The surfaces of a tracking as a folder, predictions beside corrections; a finished tracking, to be looked at.

The folder has ``surfaces.json``, with the shape of the grid and the number of frames, and a file for each frame that
was reached, as `accelsurf.track.output.frames.FrameStore` has them, without durations: the same run leaves the same
bytes.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import bounding_box, corner_of, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.image.sequence import ImageSequence
from accelsurf.io import read_json, write_bytes
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.track.output.files import read_tracks_table
from accelsurf.track.output.frames import (
    DrawnObject,
    FrameRow,
    FrameStore,
    ObjectRow,
    TrackSet,
)
from accelsurf.track.records import Lineage, SurfacePiece

#: Name of the file that describes the folder, and its version.
MARK = "surfaces.json"
VERSION = 1
#: Standard deviation, voxels, that smooths the stair steps of a label map, and voxels around it.
_SOFT = 0.8
_AROUND = 4
#: How far each voxel is from 0 at least, where 1 is a step from outside to inside.
_LEAST = 0.05
#: Velocity of a row that is only drawn.
_STILL = (0.0, 0.0, 0.0)
_TRACK = "give the folder that accelsurf track has written of this sequence"


def write_surfaces(tracks: TrackSet, folder: Path) -> None:
    """Write the folder.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    folder.mkdir()
    for row in tracks.rows:
        tracks.store.copy_frame(row.frame, folder)
    about = {
        "version": VERSION,
        "frames": len(tracks.sequence),
        "shape": list(tracks.geometry.shape),
    }
    write_bytes(folder / MARK, (json.dumps(about) + "\n").encode())


class SavedTracks:
    """A finished tracking in its folder, read frame by frame: surfaces, predictions, paths of the centroids.

    Parameters
    ----------
    folder : Path
        The output folder of ``accelsurf track``.
    name : str
        First part of the files' names: the name of the sequence.
    sequence : ImageSequence
        The tracked sequence.

    Attributes
    ----------
    ids : tuple of int
        Of all objects, rising.
    has_predictions : bool
        Whether ``NAME_surfaces`` is there; otherwise surfaces are the label maps'.

    Raises
    ------
    InputError
        When there are no files of a tracking of this sequence.
    """

    def __init__(self, folder: Path, name: str, sequence: ImageSequence) -> None:
        self._sequence = sequence
        self.name, self._rows = name, _read_rows(folder / f"{name}_tracks.csv")
        self._centroids = {
            frame: {found.id: found.centroid for found in objects}
            for frame, objects in self._rows.items()
        }
        self.ids = tuple(sorted({id for frame in self._centroids.values() for id in frame}))
        self._store: FrameStore | None = None
        self._labels: ImageSequence | None = None
        surfaces = folder / f"{name}_surfaces"
        if surfaces.is_dir():
            self._store = FrameStore(surfaces, read_only=True)
            _check_about(surfaces, sequence)
        else:
            self._labels = _label_maps(folder, name)
            _check_grid(folder, sequence, self._labels)
        self.has_predictions = self._store is not None

    def drawn(self, number: int) -> list[DrawnObject]:
        """The objects of a frame; none in one that the tracking has not reached.

        Raises
        ------
        InputError
            When its file is damaged.
        """
        if self._store is not None:
            try:
                return self._store.drawn(number) if number in self._store.numbers() else []
            except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
                raise InputError(
                    f"{self._store.folder}: frame {number} is damaged ({error})", _TRACK
                ) from None
        assert self._labels is not None  # one of both is there
        labels = self._labels.frame(number).array
        return [_piece_of(labels, int(object_id)) for object_id in np.unique(labels) if object_id]

    def track_set(self) -> TrackSet:
        """Return all frames as pictures are drawn of them; the lineage is not in it."""
        rows = tuple(
            FrameRow(number, time, 0.0, tuple(self._rows.get(number, ())))
            for number, time in enumerate(self._sequence.times)
        )
        store = _SavedFrames(self)
        return TrackSet(self.name, self._sequence, rows, Lineage((), ()), store)

    def paths(self, number: int) -> dict[int, NDArray[np.float64]]:
        """Return the centroids (n, 3), world mm, of each object of a frame in the frames up to it, rising."""
        present = self._centroids.get(number, {})
        found: dict[int, list[tuple[float, float, float]]] = {
            object_id: [] for object_id in present
        }
        for frame in sorted(self._centroids):
            if frame <= number:
                for object_id in found.keys() & self._centroids[frame].keys():
                    found[object_id].append(self._centroids[frame][object_id])
        return {object_id: np.array(places) for object_id, places in sorted(found.items())}


class _SavedFrames(FrameStore):
    """Frames of a finished tracking, as pictures need them."""

    def __init__(self, saved: SavedTracks) -> None:
        self._saved = saved

    def drawn(self, number: int) -> list[DrawnObject]:
        """Return the objects of a frame as they are drawn."""
        return self._saved.drawn(number)

    def labels(self, number: int, geometry: Geometry, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Label map (nz, ny, nx) of a frame."""
        labels = np.zeros(geometry.shape, dtype)
        for found in self.drawn(number):
            labels[found.surface.box][found.surface.psi < 0] = found.id
        return labels


def _read_rows(path: Path) -> dict[int, list[ObjectRow]]:
    """Read the objects of each frame from the table of tracks; of their numbers those that are drawn."""
    if not path.exists():
        raise InputError(f"{path}: there is no such file", _TRACK)

    def rows(_: Sequence[str], lines: Iterator[Mapping[str, str]]) -> dict[int, list[ObjectRow]]:
        found: dict[int, list[ObjectRow]] = {}
        for line in lines:
            place = float(line["x_mm"]), float(line["y_mm"]), float(line["z_mm"])
            volume = 1e3 * float(line.get("volume_ml") or 0.0)
            row = ObjectRow(
                int(line["id"]), line.get("seen") != "0", place, _STILL, volume, 0.0, 0.0
            )
            found.setdefault(int(line["frame"]), []).append(row)
        return found

    return read_tracks_table(path, rows)


def _label_maps(folder: Path, name: str) -> ImageSequence:
    """The label maps of all frames, one file or one for each."""
    for kind in IMAGE_FORMATS:
        if (folder / f"{name}_labels.{kind}").exists():
            return io.read_sequence(folder / f"{name}_labels.{kind}")
        if any(folder.glob(f"{name}_labels_t*.{kind}")):
            return io.read_sequence(folder / f"{name}_labels_t*.{kind}")
    raise InputError(f"{folder}: there are no label maps of {name}", _TRACK)


def _check_about(folder: Path, sequence: ImageSequence) -> None:
    try:
        about = read_json(folder / MARK)
        version = about["version"]
        frames = int(about["frames"])
        shape = tuple(about["shape"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: {MARK} cannot be read ({error})", _TRACK) from None
    if version != VERSION or (frames, shape) != (len(sequence), sequence.geometry.shape):
        raise InputError(f"{folder}: is of another sequence, or of another version", _TRACK)


def _check_grid(folder: Path, sequence: ImageSequence, labels: ImageSequence) -> None:
    difference = sequence.geometry.difference(labels.geometry)
    if difference or len(labels) != len(sequence):
        why = difference or f"{len(labels)} frames of {len(sequence)}"
        raise InputError(f"{folder}: the label maps are of another sequence: {why}", _TRACK)


def _piece_of(labels: NDArray[np.unsignedinteger], object_id: int) -> DrawnObject:
    """An object of a label map, its stair steps smoothed; psi is negative inside, in no unit."""
    # Not with the module: the viewer, which knows these folders, begins without half of SciPy.
    from scipy import ndimage

    inner = bounding_box(labels == object_id)
    assert inner is not None  # it has a voxel
    box = widened(inner, labels.shape, (_AROUND, _AROUND, _AROUND))
    mask = (labels[box] == object_id).astype(np.float32)
    soft = ndimage.gaussian_filter(
        mask, [_SOFT if n > 1 else 0.0 for n in labels.shape], mode="nearest"
    )
    psi = np.float32(0.5) - soft
    # No voxel changes sides: a small object would vanish.
    psi = np.where(mask > 0, np.minimum(psi, -_LEAST), np.maximum(psi, _LEAST)).astype(np.float32)
    return DrawnObject(object_id, True, SurfacePiece(corner_of(box), psi), None)
