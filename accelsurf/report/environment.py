"""The environment of a run: versions of the packages, and the memory of the process."""

from __future__ import annotations

import platform
import sys
from importlib import metadata

#: Packages that a result can depend on.
PACKAGES = (
    "accelsurf", "numpy", "scipy", "numba", "scikit-image", "SimpleITK", "trimesh", "Pillow", "pydantic",
    "matplotlib",
)


def versions() -> dict[str, str | None]:
    """Return the versions that a result can depend on: Python, the platform and the packages.

    Examples
    --------
    >>> sorted(versions())[:3]
    ['Pillow', 'SimpleITK', 'accelsurf']
    """
    found: dict[str, str | None] = {"python": platform.python_version(), "platform": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    if found["accelsurf"] is None:  # run from a source tree that is not installed
        from accelsurf import __version__

        found["accelsurf"] = __version__
    return found


def peak_rss_mb() -> float | None:
    """Return the peak memory of this process so far, in MB (10^6 bytes); None where the system does not report it."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak * (1 if sys.platform == "darwin" else 1024) / 1e6, 1)
