"""Memory and cores of the machine; the memory for an image is checked before anything is read."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Sequence
from pathlib import Path

from accelsurf.errors import InputError

_SOLVER_BYTES_PER_VOXEL = 12  # image and psi as float32, and an index of the band
_GIB = 2.0**30


def available_memory() -> int:
    """Bytes that can be allocated without swapping; on systems that do not say it, as macOS, all physical memory."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass  # not Linux
    if not hasattr(os, "sysconf"):
        return _available_on_windows()
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def available_cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _MemoryStatus(ctypes.Structure):
    """MEMORYSTATUSEX of Windows."""

    _fields_ = (
        ("length", ctypes.c_uint32),
        ("load", ctypes.c_uint32),
        ("physical", ctypes.c_uint64),
        ("available", ctypes.c_uint64),
        ("others", ctypes.c_uint64 * 5),
    )


def _available_on_windows() -> int:
    status = _MemoryStatus(length=ctypes.sizeof(_MemoryStatus))
    ctypes.CDLL("kernel32").GlobalMemoryStatusEx(ctypes.byref(status))
    return int(status.available)


def check_memory(size_xyz: Sequence[int], voxel_bytes: int, available: int) -> None:
    """Refuse an image that does not fit, with what the solver adds.

    Parameters
    ----------
    size_xyz : sequence of int
        Voxels along each axis.
    voxel_bytes : int
        Bytes of one voxel when read, all channels together.
    available : int
        Bytes.

    Raises
    ------
    InputError
        With what it needs.
    """
    needed = math.prod(size_xyz) * (voxel_bytes + _SOLVER_BYTES_PER_VOXEL)
    if needed > available:
        size = " x ".join(map(str, size_xyz))
        raise InputError(
            f"an image of {size} voxels needs about {needed / _GIB:.2f} GiB of memory, "
            f"{available / _GIB:.2f} GiB are available",
            hint="crop or downsample the image, or use a machine with more memory",
        )
