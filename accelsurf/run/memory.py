"""Memory that a run takes, by the number of its values, and memory as a person writes it.

Commands ask before they load a run.
"""

from __future__ import annotations

import re

from accelsurf.errors import UsageError
from accelsurf.settings.flow_specs import spec_of

#: Bytes of a process that has loaded the packages of a run, and of a run by its values: with clicks, and without.
PROCESS_BYTES = 450 << 20
_CLICKS_BYTES = 60
PLAIN_BYTES = 36
#: Share of the free memory that a run, or a batch, takes unless it is given a limit.
FREE_SHARE = 0.8
_MEMORY = re.compile(r"([0-9]{1,9}(?:\.[0-9]{0,6})?) *([kmgt]i?)?b?", re.IGNORECASE)
_UNITS = {"": 1, **{letter: 1000**n for n, letter in enumerate("kmgt", 1)}}
_UNITS |= {f"{letter}i": 1024**n for n, letter in enumerate("kmgt", 1)}


def allowed_bytes(text: str | None, free: int) -> int:
    """Return the memory that a run may take: the text's, else most of the free memory.

    Examples
    --------
    >>> allowed_bytes("4GB", 10), allowed_bytes(None, 10)
    (4000000000, 8)
    """
    return int(FREE_SHARE * free) if text is None else memory_of(text)


def run_bytes(values: int, clicks: bool, flow: str = "constant-density") -> int:
    """Return the estimated peak of a process that runs on a number of values, all channels together.

    Parameters
    ----------
    values : int
    clicks : bool
        Whether the run learns from clicks, which takes more.
    flow : str
        Its name.
    """
    return PROCESS_BYTES + values * _value_bytes(clicks, flow)


def values_within(bytes: int, clicks: bool, flow: str = "constant-density") -> int:
    """Return how many values a run may have within some memory; the inverse of `run_bytes`.

    Examples
    --------
    >>> values_within(run_bytes(1000, True), True)
    1000
    """
    return max(0, bytes - PROCESS_BYTES) // _value_bytes(clicks, flow)


def _value_bytes(clicks: bool, flow: str) -> int:
    return (_CLICKS_BYTES if clicks else PLAIN_BYTES) + spec_of(flow).voxel_bytes


def bytes_text(size: int) -> str:
    """Return a size as people read it.

    Examples
    --------
    >>> bytes_text(1_234_000_000), bytes_text(56_000_000)
    ('1.23 GB', '56 MB')
    """
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


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
    if size < 1_000_000:
        raise UsageError(
            f"--max-memory: {text} was given, expected at least 1MB", "as in --max-memory 4GB"
        )
    return size
