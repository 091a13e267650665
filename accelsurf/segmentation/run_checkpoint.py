"""A run between two steps, as a value and as a file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf import __version__
from accelsurf.errors import InputError
from accelsurf.evolution.energy_budget import EnergyBudget
from accelsurf.evolution.lowest import LowestState
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.evolution.records import StepFields, StepRecord, Stop
from accelsurf.evolution.rests import FoundRest, RestWatch, Slowest
from accelsurf.evolution.serialization import from_bytes, to_bytes
from accelsurf.evolution.state import Checkpoint, LoopState
from accelsurf.flows import EnergyRates
from accelsurf.grid.pyramid import Level
from accelsurf.io.files import write_bytes
from accelsurf.levelset import Snapshot, SurfaceState
from accelsurf.segmentation.object_records import ObjectCheckpoint
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.settings.run_config import RunConfig


class RunCheckpoint(NamedTuple):
    """A run between two steps, before the edits of the coming one.

    Attributes
    ----------
    step : int
        Number of the coming step.
    settings : RunConfig
        In force.
    edits_done : int
        How many edits were applied.
    level : int
    objects : tuple of ObjectCheckpoint
    summaries : tuple of LevelSummary
        Of the levels before.
    warnings : tuple of str
    """

    step: int
    settings: RunConfig
    edits_done: int
    level: int
    objects: tuple[ObjectCheckpoint, ...]
    summaries: tuple[LevelSummary, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes."""
        return sum(one.nbytes for one in self.objects)


#: The types in a checkpoint, by the names under which they are written.
TYPES: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Checkpoint, EnergyBudget, EnergyRates, Level, LevelSummary, LoopState, LowestState, ObjectCheckpoint,
        FoundRest, RestWatch, RunCheckpoint, Slowest, Snapshot, StepFields, StepRecord, Stop, SurfaceState,
    )
}


#: Settings that do not change what a run has done up to a step, or only what is written at the end.
_FREE = {"threads", "max_steps", "mesh", "mesh_space", "save_sdf", "format", "reproducible"}


class Source(Protocol):
    """What identifies a run; see `accelsurf.segmentation.run.Run`."""

    config: RunConfig
    prepared: PreprocessedInput
    given_digest: str

    @property
    def energy_name(self) -> str:
        """Name of the energy."""
        ...


def save_checkpoint(path: str | Path, checkpoint: RunCheckpoint, run: Source) -> None:
    """Write a checkpoint, completely or not at all.

    Parameters
    ----------
    path : str or Path
    checkpoint : RunCheckpoint
    run : Run
        The run: with another image, start or configuration the file is refused.

    Raises
    ------
    OutputError
        When it cannot be written.
    TypeError
        When the state of an energy of one's own is not made of numbers and arrays.
    """
    header = {"accelsurf": __version__, "run": run_digest(run)}
    state = checkpoint._replace(settings=checkpoint.settings.model_dump(mode="json"))  # type: ignore[arg-type]
    write_bytes(Path(path), to_bytes((header, state), TYPES))


def load_checkpoint(path: str | Path, run: Source) -> RunCheckpoint:
    """Read a checkpoint of a run with this image, start and configuration.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged, or is of another run.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})", "check the path") from None
    try:
        header, state = from_bytes(content, TYPES)
    except InputError as error:
        raise InputError(f"{path}: {error.message}", error.hint) from None
    settings: Any = state.settings if isinstance(state, RunCheckpoint) else None
    if not isinstance(header, dict) or not isinstance(settings, dict):
        raise InputError(f"{path}: the checkpoint is damaged (not the state of a run)", "run from the start again")
    if header.get("run") != run_digest(run):
        raise InputError(
            f"{path}: a checkpoint of another image or of other settings", "give those of the run that wrote it"
        )
    return RunCheckpoint(*state._replace(settings=RunConfig(**settings)))


def run_digest(run: Source) -> str:
    """SHA-256 of what determines the steps of a run: voxels, grid, starts and settings, but not the number of threads.

    Of an energy of one's own it is the name.
    """
    sha = hashlib.sha256()
    for volume in run.prepared.volumes:
        geometry = volume.geometry
        sha.update(f"{geometry.spacing}{geometry.origin}".encode())
        sha.update(np.ascontiguousarray(geometry.direction).tobytes())
        sha.update(digest_of({"image": volume.array}).encode())
    sha.update(f"{run.energy_name}{run.given_digest}{run.config.model_dump_json(exclude=_FREE)}".encode())
    return sha.hexdigest()


def digest_of(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of arrays by name."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sha.update(f"{name}{array.dtype.str}{array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()
