"""Errors that name a file, and writing in which a file appears complete or not at all."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from accelsurf.errors import AccelsurfError, InputError, OutputError


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong while reading a file into one line that starts with its name."""
    try:
        yield
    except AccelsurfError as error:
        raise type(error)(f"{path}: {error.message}", hint=error.hint) from error.__cause__
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error})", hint="check the path and its permissions"
        ) from error
    except RuntimeError as error:
        raise InputError(
            f"{path}: cannot be read as an image ({_itk_reason(error)})",
            hint="the file may be damaged: export it again",
        ) from error
    except MemoryError as error:
        raise InputError(f"{path}: does not fit into memory", hint="crop or downsample the image") from error


def _itk_reason(error: RuntimeError) -> str:
    """The reason alone, out of the many lines of an error of ITK."""
    text = " ".join(str(error)[-2000:].split())
    for mark in ("ERROR: ", "[nrrd] "):  # the last of a chain of calls is the cause
        text = text.rpartition(mark)[2] or text
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", text)[:200]


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """A temporary folder beside the target, gone afterwards whatever happens.

    A folder rather than a temporary name: inside it files have their final names, which an .mhd header repeats.
    """
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, a file name expected", hint="choose another name")
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name[:20]}.", dir=path.parent))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error})",
            hint=f"does the folder {path.parent} exist, is it writable, is there space on the disk?",
        ) from error
    except RuntimeError as error:
        raise OutputError(
            f"{path}: cannot be written ({_itk_reason(error)})", hint="is there space on the disk?"
        ) from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file under a temporary name in the same folder, then rename it.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    with staging(path) as folder:
        draft = folder / path.name
        draft.write_bytes(content)
        os.replace(draft, path)


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, hexadecimal, read piece by piece.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    with naming(Path(path)), Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
