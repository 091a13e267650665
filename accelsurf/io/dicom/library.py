"""The package pydicom, which is an extra, and reading one file with it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from accelsurf.errors import InputError


def library() -> ModuleType:
    """The package pydicom.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        import pydicom
    except ImportError as error:
        raise InputError("DICOM needs the package pydicom", 'install it: pip install "accelsurf[dicom]"') from error
    return pydicom


@contextmanager
def quiet() -> Iterator[None]:
    """Without the package's warnings about values that break the standard: what matters is checked here, and told."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_dataset(path: Path, tags: list[str] | None = None) -> Any:
    """Read a file: with ``tags`` those elements alone and no pixels, else all.

    Raises
    ------
    InputError
        When it is no DICOM, or damaged.
    """
    pydicom = library()
    try:
        with quiet():
            if tags is None:
                return pydicom.dcmread(path, force=True)
            return pydicom.dcmread(path, force=True, stop_before_pixels=True, specific_tags=tags)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # it raises errors of many kinds about damaged files
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{path.name}: no DICOM, or damaged ({reason})", "copy it again") from error
