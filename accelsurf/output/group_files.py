"""Results of a group of objects, each in a folder of its own: complete or not there."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, OutputError
from accelsurf.evolution import Stop
from accelsurf.grid.boxes import Box
from accelsurf.io import is_staging, read_state_file, sync, sync_folder, write_state_file
from accelsurf.output.document import describe_object, describe_window
from accelsurf.output.folder import name_of

_RECORD = "record.npz"
_STAGING = ".draft-"
#: Names of a group's folder, of one that was not complete when its process was killed, and of a mesh.
_FOLDER = re.compile(r"group-[0-9]+-[0-9a-f]{16}|\.draft-[a-z0-9_]{8}")
_MESH = r"[^/\\]+_(surface|contour)_{id}\.[a-z0-9.]+"
_FILE = re.compile(rf"{re.escape(_RECORD)}|{_MESH.format(id='[0-9]+')}")


class GroupRecord(NamedTuple):
    """Results of a group.

    Attributes
    ----------
    near : tuple of int
        Ids of objects that begin where one of the group came to; then there is nothing else.
    rows : list of dict
        As of `accelsurf.output.document.describe_object`.
    sides : ndarray (n, 3, 2) of int64
        First voxel, and the voxel after the last, of the part of the whole grid that each object has.
    low, high : ndarray (n, 3) of int64
        As of `accelsurf.large.group_run.GroupResult`.
    stops : list of Stop
    meshes : list of dict of str to str
        Of each object: name of the file by kind.
    report_entries : dict
        ``energy``, ``resolved_settings``, ``warnings``, ``window``.
    packed : list of ndarray of uint8
        Bits of the mask of each object; read from the file when they are asked for.
    place : str
        The ``folder`` where file and meshes lie, under their final names; empty in the file.
    """

    near: tuple[int, ...]
    rows: list[dict[str, Any]]
    sides: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    stops: list[Stop]
    meshes: list[dict[str, str]]
    report_entries: dict[str, Any]
    packed: list[NDArray[np.uint8]]
    place: str = ""

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        return Path(self.place)

    @property
    def boxes(self) -> list[Box]:
        """Part of the whole grid that each object has."""
        return [(slice(*z), slice(*y), slice(*x)) for z, y, x in self.sides.tolist()]

    def masks(self) -> list[NDArray[np.bool_]]:
        """Return the mask of each object, on its box."""
        packed = _read(self.folder).packed
        masks = []
        for bits, shape in zip(packed, self.sides[:, :, 1] - self.sides[:, :, 0], strict=True):
            flat = np.unpackbits(bits, count=int(shape.prod())).view(np.bool_)
            masks.append(flat.reshape(shape))
        return masks


#: The types in a record, by the names under which they are written.
TYPES: dict[str, type] = {kind.__name__: kind for kind in (GroupRecord, Stop)}


def write_group(
    folder: Path, result: Any, names: Mapping[str, str], space: Literal["lps", "ras"]
) -> None:
    """Write the files of a group.

    Parameters
    ----------
    folder : Path
        Its own, which appears when all is complete. One that is there already is left as it is.
    result : accelsurf.large.group_run.GroupResult
    names : mapping of str to str
        Name of the file of a single object by kind; of those that each object has.
    space : {"lps", "ras"}
        Of meshes.

    Raises
    ------
    OutputError
        When a mesh cannot be written; OSError when something else cannot.
    """
    objects = result.objects
    description = {key: getattr(result, key) for key in ("energy", "resolved_settings", "warnings")}
    with _staged(folder) as staged:
        record = GroupRecord(
            (),
            _plain([describe_object(segmented) for segmented in objects]),
            np.array(
                [[[side.start, side.stop] for side in each.box] for each in objects], np.int64
            ),
            np.asarray(result.low, np.int64),
            np.asarray(result.high, np.int64),
            [segmented.stop for segmented in objects],
            [_write_meshes(staged, segmented, names, space) for segmented in objects],
            _plain({**description, "window": describe_window(result.window)}),
            [np.packbits(segmented.labels) for segmented in objects],
        )
        write_state_file(staged / _RECORD, record, TYPES)


def write_near(folder: Path, ids: Sequence[int]) -> None:
    """Write that a group came to where others begin, by their ids; parameters as of `write_group`."""
    places = np.empty((0, 3), np.int64)
    record = GroupRecord(
        tuple(ids), [], np.empty((0, 3, 2), np.int64), places, places, [], [], {}, []
    )
    with _staged(folder) as staged:
        write_state_file(staged / _RECORD, record, TYPES)


def read_group(folder: Path) -> GroupRecord | None:
    """Return the record of a group; None where there is none, or files that are not ours."""
    try:
        record = _read(folder)
        if not record.near and not _are_meshes(folder, record.rows, record.meshes):
            return None
    except (InputError, ValueError, KeyError, TypeError):
        return None
    return record._replace(place=str(folder), packed=[])


def _read(folder: Path) -> GroupRecord:
    return read_state_file(folder / _RECORD, GroupRecord, TYPES, lambda record: record)


def _are_meshes(folder: Path, rows: list[dict[str, Any]], meshes: list[dict[str, str]]) -> bool:
    """Test if a record names meshes of its objects that lie in the folder itself; the record may be somebody's."""
    if folder.is_symlink() or any(path.is_symlink() for path in folder.iterdir()):
        return False
    for row, names in zip(rows, meshes, strict=True):
        for name in names.values():
            is_named = re.fullmatch(_MESH.format(id=int(row["id"])), name)
            if not (is_named and (folder / name).is_file()):
                return False
    return True


def not_of_groups(work: Path) -> list[Path]:
    """Return the paths in the folder of the groups that no group has written, sorted."""
    if not work.is_dir():
        return [work] if os.path.lexists(work) else []
    others = []
    for path in work.iterdir():
        if path.is_symlink() or not path.is_dir() or _FOLDER.fullmatch(path.name) is None:
            others.append(path)
            continue
        others += [inner for inner in path.iterdir() if not _is_of_a_group(inner)]
    return sorted(others)


def _is_of_a_group(path: Path) -> bool:
    if path.parent.name.startswith(_STAGING) and is_staging(Path(path.name)):
        return True  # of a mesh that was being written
    return _FILE.fullmatch(path.name) is not None and path.is_file() and not path.is_symlink()


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Give a folder to write in, which gets its name at the end, unless another worker was faster.

    An unreadable group of that name is removed.
    """
    staged = Path(tempfile.mkdtemp(prefix=_STAGING, dir=folder.parent))
    try:
        yield staged
        sync(staged)
        try:
            os.rename(staged, folder)
        except OSError:
            if read_group(folder) is None:
                if others := [path for path in folder.iterdir() if not _is_of_a_group(path)]:
                    raise OutputError(
                        f"{others[0]}: no run has left it there", "move it away"
                    ) from None
                shutil.rmtree(folder, ignore_errors=True)
                os.rename(staged, folder)
        sync_folder(folder.parent)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def _write_meshes(
    staged: Path, segmented: Any, names: Mapping[str, str], space: Literal["lps", "ras"]
) -> dict[str, str]:
    """Write the surface or the contours of an object; the names of its files by kind."""
    shape = "surface" if segmented.length_mm is None else "contour"
    wanted = {
        kind: name
        for kind, name in names.items()
        if kind.startswith(shape) and segmented.has_surface
    }
    files = {kind: name_of(name, segmented.id) for kind, name in wanted.items()}
    for name in files.values():
        (segmented.surface if shape == "surface" else segmented.contours).write(
            staged / name, space
        )
    return files


def _plain(value: Any) -> Any:
    """Return a value as it is read from JSON: numbers of numpy become numbers of Python."""
    return json.loads(json.dumps(value, default=lambda number: number.tolist()))
