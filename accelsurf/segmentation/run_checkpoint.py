"""A run between two steps, as a value and as a file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf import __version__
from accelsurf.errors import InputError
from accelsurf.evolution.energy_budget import EnergyBudget
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.evolution.records import StepFields, StepRecord, Stop
from accelsurf.evolution.serialization import from_bytes, to_bytes
from accelsurf.evolution.state import Checkpoint, LoopState
from accelsurf.flows import EnergyRates
from accelsurf.grid.pyramid import Level
from accelsurf.grid.volume import Volume
from accelsurf.io.files import write_bytes
from accelsurf.levelset import Snapshot, SurfaceState
from accelsurf.segmentation.object_records import ObjectCheckpoint
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
        Checkpoint, EnergyBudget, EnergyRates, Level, LevelSummary, LoopState, ObjectCheckpoint, RunCheckpoint,
        Snapshot, StepFields, StepRecord, Stop, SurfaceState,
    )
}


def save_checkpoint(path: str | Path, checkpoint: RunCheckpoint, volume: Volume, config: RunConfig) -> None:
    """Write a checkpoint, completely or not at all.

    Parameters
    ----------
    path : str or Path
    checkpoint : RunCheckpoint
    volume : Volume
        The image of the run.
    config : RunConfig
        Of the run: with another image or configuration the file is refused.

    Raises
    ------
    OutputError
        When it cannot be written.
    TypeError
        When the state of an energy of the user's own is not made of numbers and arrays.
    """
    header = {"accelsurf": __version__, "run": run_digest(volume, config)}
    state = checkpoint._replace(settings=checkpoint.settings.model_dump(mode="json"))  # type: ignore[arg-type]
    write_bytes(Path(path), to_bytes((header, state), TYPES))


def load_checkpoint(path: str | Path, volume: Volume, config: RunConfig) -> RunCheckpoint:
    """Read a checkpoint of a run with this image and configuration.

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
    if header["run"] != run_digest(volume, config):
        raise InputError(
            f"{path}: a checkpoint of another image or of other settings", "give those of the run that wrote it"
        )
    settings: Any = state.settings
    return RunCheckpoint(*state._replace(settings=RunConfig(**settings)))


def run_digest(volume: Volume, config: RunConfig) -> str:
    """SHA-256 of voxels, grid and settings, without the number of threads."""
    sha = hashlib.sha256()
    array, geometry = np.ascontiguousarray(volume.array), volume.geometry
    sha.update(f"{array.dtype.str}{array.shape}{geometry.spacing}{geometry.origin}".encode())
    sha.update(np.ascontiguousarray(geometry.direction).tobytes())
    sha.update(array.tobytes())
    sha.update(config.model_dump_json(exclude={"threads"}).encode())
    return sha.hexdigest()
