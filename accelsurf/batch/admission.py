"""Admission of cases: how many run at once, on how many threads, with how much memory, by their headers alone."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.io import count_values, options_of
from accelsurf.run import FREE_SHARE, PROCESS_BYTES, bytes_text, memory_of, run_bytes
from accelsurf.settings.reading import AS_IT_IS, ReadOptions
from accelsurf.settings.track_config import TrackConfig

#: Bytes by the values of a frame that is held beside the one that is run on: its voxels, as numbers and as labels.
_HELD_BYTES = 8


@dataclass(frozen=True)
class Need:
    """Need of a case, by its header.

    Attributes
    ----------
    values : int or None
        Values of the image, all channels and frames together; None where the header cannot be read.
    bytes : int
        Estimated peak of the process that runs it.
    problem : str
        Why the header cannot be read.
    """

    values: int | None
    bytes: int
    problem: str = ""


@dataclass(frozen=True)
class Limits:
    """Limits of a batch, as the person gave them; a cluster decides them itself.

    Attributes
    ----------
    jobs : int, optional
        Cases at the same time.
    case_timeout : float, optional
        Seconds that a case may take.
    max_memory : str, optional
        Memory of all cases together, for example 4GB.
    scheduler : str, optional
        Address of a Dask scheduler.

    Raises
    ------
    UsageError
        When a number is out of bounds, or is given with a scheduler.
    """

    jobs: int | None = None
    case_timeout: float | None = None
    max_memory: str | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(
                f"--jobs: {self.jobs} was given, expected a whole number at least 1", "leave it out"
            )
        decided = {
            "--jobs": self.jobs,
            "--case-timeout": self.case_timeout,
            "--max-memory": self.max_memory,
        }
        given = [name for name, value in decided.items() if value is not None]
        if self.scheduler is not None and given:
            raise UsageError(
                f"{given[0]}: was given with --scheduler, which decides that itself",
                "leave one out",
            )
        if self.case_timeout is not None and not 0 < self.case_timeout < float("inf"):
            raise UsageError(
                f"--case-timeout: {self.case_timeout:g} was given, expected seconds above 0",
                "as in 600",
            )

    @property
    def memory(self) -> int | None:
        """Bytes of all cases together, where they were given."""
        return None if self.max_memory is None else memory_of(self.max_memory)


@dataclass(frozen=True)
class Admission:
    """Cases that run at once.

    Attributes
    ----------
    jobs : int
        Cases at most.
    threads : int
        Of each case.
    bytes : int
        Estimates of the cases that run together add up to this at most.
    """

    jobs: int
    threads: int
    bytes: int


def need_of(
    image: Path,
    channels: Sequence[Path | str] = (),
    clicks: bool = False,
    options: ReadOptions = AS_IT_IS,
    flow: str = "constant-density",
) -> Need:
    """Estimate the memory that a case needs.

    Parameters
    ----------
    image : Path
    channels : sequence of path
        Files of further channels.
    clicks : bool
        Whether the run learns from clicks, which takes more.
    options : ReadOptions, optional
        How the image is read; further channels with the options among them that their formats have.
    flow : str
        Its name.
    """
    try:
        values = count_values(image, options)
        values += sum(
            count_values(Path(path), options.restricted_to(options_of(path))) for path in channels
        )
    except (AccelsurfError, OSError) as error:
        return Need(None, PROCESS_BYTES, str(getattr(error, "strerror", None) or error))
    return Need(values, run_bytes(values, clicks, flow))


def need_of_sequence(source: Path, config: TrackConfig) -> Need:
    """Estimate the memory that a tracking needs: a run on a frame, and the data kept of the frame before it.

    Parameters
    ----------
    source : Path
        A file with time, a folder of frames, or a pattern of their names; its headers are read.
    config : TrackConfig
    """
    from accelsurf.track import open_sequence  # only here: it loads a run

    try:
        sequence = open_sequence(source, config)
        values = sequence.frame_values
    except (AccelsurfError, OSError) as error:
        return Need(None, PROCESS_BYTES, str(getattr(error, "strerror", None) or error))
    # A stack whose slices are the frames may have to be read as a whole.
    held = values * _HELD_BYTES * (len(sequence) if config.frames_from_slices else 1)
    return Need(
        values * len(sequence),
        run_bytes(values, bool(config.run.inside), config.run.flow.name) + held,
    )


def admit(
    needs: Sequence[Need],
    cores: int,
    free: int,
    *,
    jobs: int | None = None,
    threads: int | None = None,
    memory: int | None = None,
) -> Admission:
    """Decide how many cases run at once: on all cores together, unless told otherwise.

    As many cases as there are cores, and as the memory holds of the middle one: cases on one thread each are done
    sooner than one after the other on all. A larger case waits until there is room.

    Parameters
    ----------
    needs : sequence of Need
    cores, free : int
        Cores of the machine, and bytes of its memory that are free.
    jobs, threads, memory : int, optional
        As the person said.

    Examples
    --------
    >>> needs = [Need(1, 2 << 30)] * 10
    >>> admit(needs, cores=8, free=10 << 30)
    Admission(jobs=4, threads=2, bytes=8589934592)
    >>> admit(needs, cores=8, free=10 << 30, jobs=2).threads, admit(needs, cores=8, free=10 << 30, threads=4).jobs
    (4, 2)
    """
    total = int(FREE_SHARE * free) if memory is None else memory
    if jobs is None:
        middle = statistics.median_high([need.bytes for need in needs] or [PROCESS_BYTES])
        jobs = max(1, min(cores // (threads or 1), len(needs), total // middle))
    return Admission(jobs, threads or max(1, cores // jobs), total)


def by_cluster(needs: Sequence[Need], threads: int | None = None) -> Admission:
    """Nothing to decide where a cluster does: all cases at once, each on one thread unless told otherwise.

    Examples
    --------
    >>> by_cluster([Need(1, 1000), Need(1, 2000)])
    Admission(jobs=2, threads=1, bytes=3000)
    """
    return Admission(max(len(needs), 1), threads or 1, sum(need.bytes for need in needs))


def plan_rows(needs: Mapping[str, Need], admission: Admission) -> list[tuple[str, str, str, str]]:
    """Return the rows of a table: id, values, estimate, and its error or when it runs."""
    rows = []
    for name, need in needs.items():
        if need.values is None:
            rows.append((name, "-", "-", need.problem))
            continue
        size = bytes_text(need.bytes)
        note = ""
        if need.bytes > admission.bytes:
            note = f"needs more than {bytes_text(admission.bytes)}: is not run"
        elif need.bytes * admission.jobs > admission.bytes:
            note = "waits for room"
        rows.append((name, str(need.values), size, note))
    return rows
