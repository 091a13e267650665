"""The packages of the extra ``mesh``."""

from __future__ import annotations

import importlib
from typing import Any

from accelsurf.errors import InputError


def library(name: str) -> Any:
    """Return a package.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.replace("_", "-")
        raise InputError(
            f"coarser meshes need the package {package}", 'install it: pip install "accelsurf[mesh]"'
        ) from None
