"""Errors that name a file, and writing in which a file appears complete or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from accelsurf.errors import AccelsurfError, InputError, OutputError
from accelsurf.io.file_set import FileSet, open_set
from accelsurf.settings import budgets
from accelsurf.settings.budgets import Budget
from accelsurf.settings.reading import check_readable

SPACE_HINT = "is there space on the disk?"
#: Message and hint where a file is not the one that was opened.
CHANGED = (
    "the image has changed since it was opened",
    "let no other program write it; then start again",
)
_BLOCK = 1 << 20  # bytes that are compared at once


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong while reading a file into one line that starts with its name; refuse pipes at once."""
    try:
        check_readable(path)
        yield
    except AccelsurfError as error:
        raise type(error)(f"{path}: {error.message}", hint=error.hint) from error.__cause__
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error})",
            hint="check the path and its permissions",
        ) from error
    except RuntimeError as error:
        raise InputError(
            f"{path}: cannot be read as an image ({_itk_reason(error)})",
            hint="the file may be damaged: export it again",
        ) from error
    except MemoryError as error:
        raise InputError(
            f"{path}: does not fit into memory", hint="crop or downsample the image"
        ) from error


@contextmanager
def library_named(what: str, hint: str) -> Iterator[None]:
    """Turn whatever a library raises about damaged content into one line; to be put around its calls alone.

    Parameters
    ----------
    what : str
        The damage, for the message.
    hint : str
        Advice to the user.
    """
    try:
        yield
    except (AccelsurfError, MemoryError, OSError) as error:
        # Damage is no fault of the disk; gzip reports it by an OSError without a number.
        if not isinstance(error, OSError) or error.errno is not None:
            raise
        raise InputError(f"{what} ({one_line(error)})", hint) from error
    except (
        Exception
    ) as error:  # zlib, lzma, zipfile, gzip, struct, numpy, nibabel: each has its own kinds
        raise InputError(f"{what} ({one_line(error)})", hint) from error


def one_line(error: Exception) -> str:
    """Message of a library's error, on one line of at most 200 characters."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def bytes_within(path: str | os.PathLike[str], budget: Budget) -> bytes:
    """All bytes of a file that is no larger than a budget.

    Raises
    ------
    InputError
        When it is larger, cannot be read, or is a pipe, a device or a folder.
    """
    path = Path(path)
    with naming(path):
        with path.open("rb") as file:
            budget.check(os.fstat(file.fileno()).st_size)
            return file.read()


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError
        When it cannot be read, is none, or is larger than a report may be.
    """
    content = bytes_within(path, budgets.REPORT)
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON ({one_line(error)})", "is it the right file?") from None


def _itk_reason(error: RuntimeError) -> str:
    """The reason alone, out of the many lines of an error of ITK."""
    text = " ".join(str(error)[-2000:].split())
    for mark in ("ERROR: ", "[nrrd] "):  # the last of a chain of calls is the cause
        text = text.rpartition(mark)[2] or text
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", text)[:200]


def file_version(path: Path) -> tuple[int, ...]:
    """Numbers that change when a file is written or replaced."""
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def refuse_changed(path: Path, version: tuple[int, ...]) -> None:
    """Refuse a file that is not the one that was opened.

    Raises
    ------
    InputError
        When its numbers of `file_version` are others; OSError when it is gone.
    """
    if file_version(path) != version:
        raise InputError(*CHANGED)


@contextmanager
def staging(path: Path, folder_marks: tuple[str, ...] = ()) -> Iterator[FileSet]:
    """Staging files of an output and of its further files, removed afterwards whatever happens; see `FileSet.commit`.

    They have their final names in a folder of their own, because an .mhd header repeats the name of its data.

    Parameters
    ----------
    path : Path
        The output.
    folder_marks : tuple of str
        A folder that is there already is replaced if it has one of these files, else never.

    Raises
    ------
    OutputError
        When nothing can be written there, or the work inside raises an error of Python or ITK on a full disk.
    """
    try:
        if path.is_dir() and not any((path / mark).is_file() for mark in folder_marks):
            raise OutputError(
                f"{path}: is a folder, a file name expected", hint="choose another name"
            )
        with open_set(path.parent, path.name, unique=True) as files:
            yield files
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error})",
            hint=f"does the folder {path.parent} exist, is it writable, is there space on the disk?",
        ) from error
    except RuntimeError as error:
        raise OutputError(
            f"{path}: cannot be written ({_itk_reason(error)})", hint=SPACE_HINT
        ) from error


class StagedOutput:
    """An output that is written piece by piece. It appears when it is committed, whole, or not at all.

    Used with ``with``, it is committed at the end, and aborted where an error ends the block.

    Parameters
    ----------
    path : Path
        A star in its name stands for the numbers of several files.
    folder_marks : tuple of str
        As of `staging`.

    Raises
    ------
    OutputError
        When nothing can be written there.
    """

    def __init__(self, path: Path, folder_marks: tuple[str, ...]) -> None:
        self.path = path
        self._stack = ExitStack()
        name = path.name.replace("*", "_")
        self._files = self._stack.enter_context(staging(path.with_name(name), folder_marks))

    def commit(self) -> object:
        """Put the output in its place.

        Raises
        ------
        OutputError
            When it cannot be written; nothing is left behind then.
        """
        raise NotImplementedError

    def abort(self) -> None:
        """Remove the written files; after `commit` this does nothing."""
        self._stack.pop_all().close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is None:
            self.commit()
        else:
            self.abort()

    @contextmanager
    def _aborted_on_failure(self) -> Iterator[None]:
        """Turn an error while staging files are written into one line with the name of the output; remove them."""
        try:
            yield
        except AccelsurfError as error:
            self.abort()
            message = error.message.replace(str(self._files.staging), str(self.path.parent))
            raise type(error)(message, error.hint) from error
        except OSError as error:
            self.abort()
            raise OutputError(
                f"{self.path}: cannot be written ({error.strerror or error})",
                f"does the folder {self.path.parent} exist, is it writable? {SPACE_HINT}",
            ) from error
        except BaseException:
            self.abort()
            raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, read it back, compare, and rename it.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    with staging(path) as files:
        staged = files.staging / path.name
        staged.write_bytes(content)
        check_bytes(staged, content)
        files.commit()


def check_bytes(staged: Path, content: bytes) -> None:
    """Refuse a staging file that differs from its intended content.

    Raises
    ------
    OutputError
        With the difference.
    """
    size = staged.stat().st_size
    if size != len(content):
        raise OutputError(incomplete(staged, f"{size} of {len(content)} bytes arrived"), SPACE_HINT)
    meant = memoryview(content)
    with staged.open("rb") as file:
        for begin in range(0, len(content), _BLOCK):
            if file.read(_BLOCK) != meant[begin : begin + _BLOCK]:
                raise OutputError(
                    incomplete(staged, "other bytes are read than were written"), SPACE_HINT
                )


def incomplete(staged: Path, reason: str) -> str:
    """The message about a staging file that differs from its intended content."""
    return f"{staged.name}: cannot be written ({reason})"


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, hexadecimal, read piece by piece; of a folder or of a pattern, of
    the names and bytes of the files.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    path = Path(path)
    with naming(path):
        if path.is_dir():
            return _files_sha256(path, _names_in(path))
        if not path.exists():
            names = os.listdir(path.parent) if path.parent.is_dir() else []
            if found := sorted(name for name in names if fnmatchcase(name, path.name)):
                return _files_sha256(path.parent, found)
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def written_at(path: Path) -> list[int]:
    """Return number of files, bytes and the newest time, ns: they change when a file, or one of a folder, is written.

    Raises
    ------
    InputError
        When it cannot be looked at.
    """
    with naming(path):
        files = [path / name for name in _names_in(path)] if path.is_dir() else [path]
        found = [file.stat() for file in files]
    newest = max((each.st_mtime_ns for each in found), default=0)
    return [len(found), sum(each.st_size for each in found), newest]


def _names_in(folder: Path) -> list[str]:
    """Names of the files of an image in a folder."""
    names = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    # The labels of an OME-Zarr image, in its folder, are not the image; in other folders all files count.
    besides = "labels/" if (folder / "zarr.json").is_file() else None
    return sorted(name for name in names if besides is None or not name.startswith(besides))


def _files_sha256(folder: Path, names: Sequence[str]) -> str:
    total = hashlib.sha256()
    for name in names:
        with (folder / name).open("rb") as file:
            total.update(hashlib.file_digest(file, "sha256").digest() + os.fsencode(name) + b"\0")
    return total.hexdigest()
