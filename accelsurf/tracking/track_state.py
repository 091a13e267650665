"""The state of a tracking after a frame, as a file from which it goes on to the same bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf.errors import AccelsurfError, InputError
from accelsurf.evolution.serialization import from_bytes, to_bytes
from accelsurf.image.sequence import ImageSequence
from accelsurf.io.files import bytes_within, write_bytes
from accelsurf.run.checkpoint import FREE, digest_of, versions
from accelsurf.settings import budgets
from accelsurf.settings.track_config import TrackConfig
from accelsurf.settings.wording import shown
from accelsurf.tracking.frame_run import Measured
from accelsurf.tracking.momentum import Triple
from accelsurf.tracking.records import SurfacePiece

#: Version of the file; raised when its content changes.
VERSION = 1
_BEGIN = "begin anew without --resume, with --overwrite"


class Header(NamedTuple):
    """Header of a state: ``version`` of the file, ``versions`` of what the numbers depend on, ``digest`` of
    the sequence, and ``settings``.
    """

    version: int
    versions: dict[str, str]
    digest: str
    settings: dict[str, Any]


class TrackState(NamedTuple):
    """A tracking after a frame.

    Attributes
    ----------
    done : int
        How many frames are done.
    seed : int or None
    first : tuple of (int, Measured)
        Objects of the first frame.
    velocities : dict of int to (x, y, z)
        Of these, after the first step.
    identities : dict
    objects : tuple of dict
        Those that are followed.
    warnings : tuple of str
    """

    done: int
    seed: int | None
    first: tuple[tuple[int, Measured], ...]
    velocities: dict[int, Triple]
    identities: dict[str, Any]
    objects: tuple[dict[str, Any], ...]
    warnings: tuple[str, ...]


TYPES: dict[str, type] = {kind.__name__: kind for kind in (Header, Measured, SurfacePiece, TrackState)}


def header_of(sequence: ImageSequence, config: TrackConfig, meshes: bool) -> Header:
    """The header of a tracking's states, the same at every frame.

    Of the sequence it has grid, times and the voxels of the first frame that is done.
    """
    sha, geometry = hashlib.sha256(), sequence.geometry
    sha.update(f"{geometry.shape}{geometry.spacing}{geometry.origin}{sequence.times}{sequence.time_unit}".encode())
    sha.update(digest_of({"direction": geometry.direction, "image": sequence.frame(config.frame).array}).encode())
    run = config.run.model_dump(mode="json", exclude=set(FREE))
    tracking = config.model_dump(mode="json", exclude={"run"})
    return Header(VERSION, versions(), sha.hexdigest(), {**run, **tracking, "meshes": meshes})


def write(path: Path, state: TrackState, header: Header) -> None:
    """Write a state, completely or not at all.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    write_bytes(path, to_bytes((header, state), TYPES))


def read(path: Path) -> tuple[Header, TrackState]:
    """Read a state of any tracking.

    Raises
    ------
    InputError
        When the file cannot be read or is damaged.
    """
    content = bytes_within(path, budgets.STATE_FILE)
    try:
        header, state = from_bytes(content, TYPES)
        if not isinstance(header, Header) or not isinstance(state, TrackState) or header.version != VERSION:
            raise ValueError("not the state of a tracking of this version")
        return header, state
    except InputError as error:
        raise InputError(f"{path}: {error.message}", _BEGIN) from None
    except (AccelsurfError, ValueError, TypeError) as error:
        raise InputError(f"{path}: the state is damaged ({error})", _BEGIN) from None


def refuse_another(path: Path, header: Header, expected: Header) -> None:
    """Refuse the state of another tracking; what differs is named.

    Raises
    ------
    InputError
    """
    if (header.digest, header.settings) == (expected.digest, expected.settings):
        return
    other = [key for key in expected.settings if header.settings.get(key) != expected.settings[key]]
    what = "another sequence"
    if other:
        key = other[0]
        what = f"other settings: {key} was {shown(header.settings.get(key))}, is {shown(expected.settings[key])}"
    raise InputError(f"{path}: a state of {what}", "give those of the run that wrote it, or begin anew")
