"""How many cases run at once, on how many threads each, with how much memory; nothing is read but headers."""

from __future__ import annotations

import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.io.headers import count_values

#: Bytes of a process that has loaded what a case needs, and of a case by its values: with clicks, and without.
PROCESS_BYTES, CLICKS_BYTES, PLAIN_BYTES = 450 << 20, 60, 36
#: Share of the free memory that a batch takes unless it is told.
FREE_SHARE = 0.8

_MEMORY = re.compile(r"([0-9]{1,9}(?:\.[0-9]{0,6})?) *([kmgt]i?)?b?", re.IGNORECASE)
_UNITS = {"": 1, **{letter: 1000**n for n, letter in enumerate("kmgt", 1)}}
_UNITS |= {f"{letter}i": 1024**n for n, letter in enumerate("kmgt", 1)}


@dataclass(frozen=True)
class Need:
    """What a case needs, by its header.

    Attributes
    ----------
    values : int or None
        Values of the image, all channels together; None where the header cannot be read.
    bytes : int
        Estimated peak of the process that runs it.
    problem : str
        Why the header cannot be read.
    """

    values: int | None
    bytes: int
    problem: str = ""


@dataclass(frozen=True)
class Admission:
    """What runs at once.

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


def need_of(image: Path, channels: Sequence[Path | str] = (), clicks: bool = False) -> Need:
    """Estimate what a case needs.

    Parameters
    ----------
    image : Path
    channels : sequence of path
        Files of further channels.
    clicks : bool
        Whether the run learns from clicks, which takes more.
    """
    try:
        values = sum(count_values(Path(path)) for path in (image, *channels))
    except (AccelsurfError, OSError) as error:
        return Need(None, PROCESS_BYTES, str(getattr(error, "strerror", None) or error))
    return Need(values, PROCESS_BYTES + values * (CLICKS_BYTES if clicks else PLAIN_BYTES))


def admit(
    needs: Sequence[Need],
    cores: int,
    free: int,
    *,
    jobs: int | None = None,
    threads: int | None = None,
    memory: int | None = None,
) -> Admission:
    """Decide what runs at once: on all cores together, unless told otherwise.

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


def memory_of(text: str) -> int:
    """Return bytes that are written with a unit.

    Raises
    ------
    UsageError
        When they are not.

    Examples
    --------
    >>> memory_of("4GB"), memory_of("512 MiB"), memory_of("1.5g")
    (4000000000, 536870912, 1500000000)
    """
    found = _MEMORY.fullmatch(text.strip())
    size = int(float(found[1]) * _UNITS[(found[2] or "").lower()]) if found is not None else 0
    if size < 1 << 20:
        raise UsageError(f"--max-memory: {text} was given, expected at least 1MB", "as in --max-memory 4GB")
    return size


def bytes_text(size: int) -> str:
    """Return a size as people read it.

    Examples
    --------
    >>> bytes_text(1_234_000_000), bytes_text(56_000_000)
    ('1.23 GB', '56 MB')
    """
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def plan_rows(needs: Mapping[str, Need], admission: Admission) -> list[tuple[str, str, str, str]]:
    """Return the rows of a table: id, values, estimate, and what is wrong or when it runs."""
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
