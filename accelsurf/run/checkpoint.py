"""A run between two steps, as a value and as a file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.evolution import (
    Checkpoint,
    EnergyBudget,
    FoundPlateau,
    LevelSummary,
    LoopState,
    LowestState,
    PlateauWatch,
    Slowest,
    StepFields,
    StepRecord,
    Stop,
)
from accelsurf.flows import EnergyRates
from accelsurf.grid.pyramid import Level
from accelsurf.grid.window import Window
from accelsurf.io import read_state_file, write_state_file
from accelsurf.kernels.storage import compiler_version, processor_name
from accelsurf.levelset import Snapshot, SurfaceState
from accelsurf.run.evolving_object import ObjectCheckpoint
from accelsurf.run.late_growth import GrowthState
from accelsurf.run.preprocessing import PreprocessedInput
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import shown
from accelsurf.version import __version__

#: Settings that do not change the steps of a run so far, or change the outputs only.
FREE = frozenset(
    {
        "threads",
        "max_steps",
        "mesh",
        "mesh_space",
        "save_sdf",
        "format",
        "reproducible",
        "keep_state",
        "checkpoint",
    }
)
_BEGIN = "begin anew without --resume, with --overwrite"


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
    growth : GrowthState or None
        Of the observer of late leakage (`accelsurf.run.late_growth`), where there is one.
    """

    step: int
    settings: RunConfig
    edits_done: int
    level: int
    objects: tuple[ObjectCheckpoint, ...]
    summaries: tuple[LevelSummary, ...] = ()
    warnings: tuple[str, ...] = ()
    growth: GrowthState | None = None

    @property
    def nbytes(self) -> int:
        """Upper bound of its memory, bytes."""
        return sum(segmented.nbytes for segmented in self.objects)


class CheckpointHeader(NamedTuple):
    """Identity of the run of a checkpoint.

    Attributes
    ----------
    versions : dict of str to str
        Of accelsurf and the packages that its numbers depend on; ``processor``, for which the code was compiled.
    run : str
        `_run_digest`.
    settings : dict
        Those that the run began with, with the seed that was drawn.
    window : tuple of int or None
        First voxel and shape of the part of a large image that the run was made on, and for how many levels it has the
        blocks of the whole; None for the whole.
    """

    versions: dict[str, str]
    run: str
    settings: dict[str, Any]
    window: tuple[int, ...] | None = None


class SavedRun(NamedTuple):
    """A checkpoint as it is written, with the ``header`` that says of which run; settings are plain values there."""

    header: CheckpointHeader
    state: RunCheckpoint


#: The types in a checkpoint, by the names under which they are written.
TYPES: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Checkpoint,
        CheckpointHeader,
        EnergyBudget,
        EnergyRates,
        FoundPlateau,
        GrowthState,
        Level,
        LevelSummary,
        LoopState,
        LowestState,
        ObjectCheckpoint,
        PlateauWatch,
        RunCheckpoint,
        SavedRun,
        Slowest,
        Snapshot,
        StepFields,
        StepRecord,
        Stop,
        SurfaceState,
    )
}


class Source(Protocol):
    """Identity of a run; see `accelsurf.run.run.Run`."""

    config: RunConfig
    prepared: PreprocessedInput
    given_digest: str
    window: Window | None

    @property
    def energy_name(self) -> str:
        """Name of the energy."""
        ...


def versions() -> dict[str, str]:
    """Return the versions on which the bytes of a result depend besides image and settings."""
    return {
        "accelsurf": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": compiler_version(),
        "processor": processor_name(),
    }


def checkpoint_header(run: Source) -> CheckpointHeader:
    """The header of a run's checkpoints, the same at every step."""
    window = (
        None if run.window is None else (*run.window.corner, *run.window.shape, run.window.levels)
    )
    return CheckpointHeader(
        versions(), _run_digest(run), run.config.model_dump(mode="json"), window
    )


def save_checkpoint(path: str | Path, checkpoint: RunCheckpoint, header: CheckpointHeader) -> None:
    """Write a checkpoint, completely or not at all.

    Parameters
    ----------
    path : str or Path
    checkpoint : RunCheckpoint
    header : CheckpointHeader
        From `checkpoint_header`: for a run with another image, start or configuration the file is refused.

    Raises
    ------
    OutputError
        When it cannot be written.
    TypeError
        When the state of an energy of one's own is not made of numbers and arrays.
    """
    objects = tuple(
        segmented._replace(evolution=segmented.evolution.without_costs)
        for segmented in checkpoint.objects
    )
    settings: Any = checkpoint.settings.model_dump(mode="json")
    state = checkpoint._replace(objects=objects, settings=settings)
    write_state_file(Path(path), SavedRun(header, state), TYPES)


def read_checkpoint(path: str | Path) -> SavedRun:
    """Read a checkpoint of any run.

    Raises
    ------
    InputError
        When the file cannot be read or is damaged.
    """
    return read_state_file(Path(path), SavedRun, TYPES, _checked, _BEGIN)


def _checked(saved: SavedRun) -> SavedRun:
    """The checkpoint with its settings made again; a ValueError where they or the window are not valid."""
    window = saved.header.window
    if window is not None and not (len(window) == 7 and min(window) >= 0):
        raise ValueError("its window is not valid")
    settings: Any = saved.state.settings
    return saved._replace(state=saved.state._replace(settings=RunConfig(**settings)))


def load_checkpoint(path: str | Path, run: Source) -> RunCheckpoint:
    """Read a checkpoint of a run with this image, start and configuration.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged, or is of another run; the difference is named.
    """
    header, state = read_checkpoint(path)
    refuse_another_run(path, header, checkpoint_header(run))
    return state


def refuse_another_run(
    path: str | Path,
    header: CheckpointHeader,
    here: CheckpointHeader,
    difference: str = "another image or start",
) -> None:
    """Refuse a state that is not of the run with header ``here``.

    Its settings that differ are named, else ``difference``.

    Raises
    ------
    InputError
    """
    if header.run == here.run:
        return
    there = header.settings
    other = [
        key for key in here.settings if key not in FREE and there.get(key) != here.settings[key]
    ]
    if other:
        key = other[0]
        more = f" and {len(other) - 1} more" if len(other) > 1 else ""
        difference = f"other settings: {key} was {shown(there.get(key))}, is {shown(here.settings[key])}{more}"
    raise InputError(
        f"{path}: a checkpoint of {difference}",
        "give those of the run that wrote it, or begin anew",
    )


def _run_digest(run: Source) -> str:
    """SHA-256 of the data that determine the steps of a run: voxels, grid, starts, settings, not the number of threads.

    Of an energy of one's own it is the name.
    """
    sha = hashlib.sha256()
    for volume in run.prepared.volumes:
        geometry = volume.geometry
        sha.update(f"{geometry.spacing}{geometry.origin}".encode())
        sha.update(np.ascontiguousarray(geometry.direction).tobytes())
        sha.update(digest_of({"image": volume.array}).encode())
    sha.update(
        f"{run.energy_name}{run.given_digest}{run.config.model_dump_json(exclude=set(FREE))}".encode()
    )
    return sha.hexdigest()


def digest_of(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of arrays by name."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sha.update(f"{name}{array.dtype.str}{array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()
