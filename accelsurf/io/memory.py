"""Memory and cores of the machine; the memory for an image is checked before anything is read."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

from accelsurf.errors import InputError

_SOLVER_BYTES_PER_VOXEL = 12  # image and psi as float32, and an index of the band
_GIB = 2.0**30


def available_memory() -> int:
    """Bytes that can be allocated without swapping."""
    import psutil

    return int(psutil.virtual_memory().available)


def available_cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_memory(size_xyz: Sequence[int], voxel_bytes: int, available: int) -> None:
    """Refuse an image that does not fit into the memory together with the solver's arrays.

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
        With the memory that it needs.
    """
    needed = math.prod(size_xyz) * (voxel_bytes + _SOLVER_BYTES_PER_VOXEL)
    if needed > available:
        size = " x ".join(map(str, size_xyz))
        raise InputError(
            f"an image of {size} voxels needs about {needed / _GIB:.2f} GiB of memory, "
            f"{available / _GIB:.2f} GiB are available",
            hint="crop or downsample the image, or use a machine with more memory",
        )
