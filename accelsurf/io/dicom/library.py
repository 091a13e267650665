"""The packages pydicom and highdicom, which are an extra, and reading one file."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from accelsurf.errors import InputError

#: Those that send lines to stderr where nobody asked for logs.
_LOGGERS = ("pydicom", "highdicom")


def library(name: str = "pydicom") -> ModuleType:
    """One of the packages, or a module of it.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        with quiet():
            return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise InputError(f"DICOM needs the package {package}", 'install it: pip install "accelsurf[dicom]"') from error


@contextmanager
def quiet() -> Iterator[None]:
    """Without the packages' warnings and log lines about values that break the standard: what matters is checked here,
    and told.
    """
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.setLevel(logging.CRITICAL + 1)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


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
