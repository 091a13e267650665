"""Files that belong together: each appears whole, the report last; files of a killed run are no result.

New files lie in a hidden folder beside the outputs, the *staging folder*, until all are complete and on the disk. Then
they come to their places one by one. The last one, a report that names the others, is the first old one to go and the
last new one to come: where a report stands, its files are those that it names. Old files lie in the staging folder
until the report is there, and come back where a move fails. A process that is killed between two moves leaves a set
without a report: it is *unfinished*. The next command says so, and a run that may replace the files makes them anew.

Nothing that lies in an output folder orders anything. A staging folder is this user's where its name has the seal of
its set and of the folder that it lies in (`accelsurf.io.seals`); others are named and left alone. A lock in it ends
with its process: who gets the lock of a staging folder that is there already knows that its writer is dead.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import signal
import stat
import sys
import threading
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from accelsurf.errors import AccelsurfWarning, OutputError
from accelsurf.io import seals

#: Signals that end a program on request.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: In a staging folder: new files, old ones, new ones of a run that mends an unfinished set, discards, and the lock.
_NEW = "new"
_OLD = "old"
_AGAIN = "again"
_GONE = "gone"
_LOCK = "lock"
#: Another process looks for a moment if the writer of a set is dead, and holds its lock then.
_TRIES = 10
_TRY_SECONDS = 0.03
#: Reparse tag of a junction on Windows: a link between folders.
_JUNCTION = 0xA0000003
#: Foreign staging folders that a warning names.
_NAMED = 3
#: Name of a staging folder: name of the set, digits that tell two of one set apart, and the seal of both.
_STAGING = re.compile(
    r"\.(?P<name>.+)\.(?P<salt>[0-9a-f]{8})(?P<seal>[0-9a-f]{16})\.accelsurf", re.DOTALL
)
#: Digits of a set that one process at a time writes.
_ALONE = "0" * 8
#: Longest name of a set that is repeated in the name of its staging folder, bytes: file systems allow 255.
_MAX_NAME_BYTES = 200
#: A link in the place of a lock is not followed.
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
#: First and last characters of the name of a staging folder.
PREFIX = "."
SUFFIX = ".accelsurf"


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let both signals wait until the end of a short piece of work, for example renames; then they act as before."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled in the main thread alone
        return
    waiting: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    python_ones = [
        signal.Signals(number) for number, handler in before.items() if callable(handler)
    ]
    for number in python_ones:
        signal.signal(number, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        for number in python_ones:
            signal.signal(number, before[number])
        for came in waiting:
            signal.raise_signal(came)


@dataclass(frozen=True)
class _FolderLock:
    """A staging folder that this process writes in, and the open file by which it is locked; -1 without a lock."""

    folder: Path
    lock: int = -1

    @property
    def is_unfinished(self) -> bool:
        """True if files were being put in place: until the report has left, the last of the new ones."""
        return (self.folder / _OLD).is_dir() and not _is_empty(self.folder / _NEW)

    def release(self) -> None:
        """Free the lock, and leave the folder."""
        if self.lock >= 0:
            os.close(self.lock)

    def remove(self) -> None:
        """Remove the folder, its lock last, and free the lock."""
        shutil.rmtree(self.folder / _OLD, ignore_errors=True)  # first: see `is_unfinished`
        if sys.platform == "win32":
            self.release()  # an open file cannot be removed there
            shutil.rmtree(self.folder, ignore_errors=True)
        else:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.release()


class FileSet:
    """Staging files that will stand in one folder; made by `open_set`.

    Attributes
    ----------
    folder : Path
        Where the files will be.
    committed : bool
        True when they are in place, or when some are and could not be taken back.
    """

    def __init__(
        self, folder: Path, folder_lock: _FolderLock, left: Sequence[Path], inputs: Sequence[Path]
    ) -> None:
        self.folder = folder
        self._folder_lock = folder_lock
        self._left = left
        self._inputs = inputs
        self._mends = folder_lock.is_unfinished
        self.committed = False
        shutil.rmtree(self.staging, ignore_errors=True)  # of a run that was killed
        os.mkdir(self.staging)

    @property
    def staging(self) -> Path:
        """The folder in which the files are written, under their final names."""
        return self._folder_lock.folder / (_AGAIN if self._mends else _NEW)

    @property
    def earlier(self) -> tuple[Path, ...]:
        """Folders with the files that a killed run has left of an unfinished set, with its reports, old and new."""
        return (
            (self._folder_lock.folder / _NEW, self._folder_lock.folder / _OLD)
            if self._mends
            else ()
        )

    def discard(self) -> None:
        """Remove the staging files."""
        shutil.rmtree(self.staging, ignore_errors=True)
        # Where somebody has removed the output folder, the next file that is written says so.
        with suppress(FileNotFoundError):
            self.staging.mkdir(exist_ok=True)

    def commit(
        self, last: str | None = None, remove: Iterable[str] = (), mends: bool = True
    ) -> None:
        """Put all staging files in place of the old files of their names. Signals wait until that is done.

        Parameters
        ----------
        last : str, optional
            The file that names the others: no old one stands beside new files, and no new one beside old files.
        remove : iterable of str
            Names of old files to remove; names of staging files and of files that are not there are ignored.
        mends : bool
            False where the files are not the whole set, as after a failed run: an unfinished set stays unfinished then.

        Raises
        ------
        OSError
            When a file cannot be put in place; then the old ones are there as before.
        OutputError
            When one of the old files is an input of the run.
        """
        names = sorted(path.name for path in self.staging.iterdir() if path.name != last)
        all_names = names if last is None else [*names, last]
        gone = [
            name for name in remove if name not in all_names and os.path.lexists(self.folder / name)
        ]
        InputFiles(self._inputs).refuse(self.folder / name for name in (*all_names, *gone))
        for path in self.staging.iterdir():
            sync(path)
        with uninterrupted():
            if self._mends and mends:
                self._begin_again()
            if len(all_names) == 1 and not gone and not self._has_folder(all_names[0]):
                # All or nothing by itself.
                os.replace(self.staging / all_names[0], self.folder / all_names[0])
            else:
                self._exchange(names, last, gone)
            self.committed = True
            sync_folder(self.folder)
            for folder in self._left:
                shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(self._old, ignore_errors=True)

    @property
    def _old(self) -> Path:
        """The folder for old files; another one where the old ones of an unfinished set have to stay."""
        return self._folder_lock.folder / (f"{_OLD} {_AGAIN}" if self._mends else _OLD)

    def _begin_again(self) -> None:
        """Let the files of this run take the place of those that a killed one has left; the set stays unfinished."""
        folder = self._folder_lock.folder
        shutil.rmtree(folder / _GONE, ignore_errors=True)
        with suppress(FileNotFoundError):  # a kill may have come between these two
            os.rename(folder / _NEW, folder / _GONE)
        os.rename(folder / _AGAIN, folder / _NEW)
        self._mends = False

    def _exchange(self, names: Sequence[str], last: str | None, gone: Sequence[str]) -> None:
        """Move old files away and new ones to their places, one by one; a move that fails takes all back."""
        old = self._old
        moved: list[tuple[Path, Path]] = []

        def move(source: Path, goal: Path) -> None:
            os.replace(source, goal)
            moved.append((source, goal))

        def set_aside(name: str) -> None:
            if (old / name).is_dir():  # of a run that was killed: a folder is not replaced
                shutil.rmtree(old / name, ignore_errors=True)
            if os.path.lexists(self.folder / name):
                move(self.folder / name, old / name)

        def put(name: str) -> None:
            set_aside(name)
            move(self.staging / name, self.folder / name)

        sync_folder(self.staging)
        old.mkdir(exist_ok=True)
        self.committed = True  # from here on files are not to be removed, whatever happens
        try:
            if last is not None and os.path.lexists(self.folder / last):
                set_aside(last)
                sync_folder(
                    self.folder
                )  # so that a power cut leaves no old report beside new files
            for name in names:
                put(name)
            for name in gone:
                set_aside(name)
            if last is not None:
                sync_folder(self.folder)
                put(last)
        except Exception:
            for source, goal in reversed(moved):
                os.replace(goal, source)
            shutil.rmtree(old, ignore_errors=True)
            self.committed = False
            raise

    def _has_folder(self, name: str) -> bool:
        """Test if the staging file of a name, or the old file, is a folder: the system does not exchange these."""
        return (self.staging / name).is_dir() or (self.folder / name).is_dir()


@contextmanager
def open_set(
    folder: Path,
    name: str,
    unique: bool = False,
    inputs: Sequence[Path] = (),
    mend: bool = False,
) -> Iterator[FileSet]:
    """Prepare a set of files. New files that a killed process has left are removed first.

    Parameters
    ----------
    folder : Path
        Exists.
    name : str
        Of the set. Only one process of this user at a time writes a set of this name.
    unique : bool
        True if others may write one of this name at the same time: who ends last, wins.
    inputs : sequence of Path, optional
        Files that are not replaced or removed, under whatever name.
    mend : bool
        True if an unfinished set of this name may be made anew.

    Raises
    ------
    OSError
        When nothing can be written there.
    OutputError
        When another process is writing this set, the set is unfinished, or the folder is a link.

    Warns
    -----
    AccelsurfWarning
        Of staging folders that are not of this user's runs, and where there is no key or no lock.
    """
    refuse_links(folder)
    short = _short(name)
    left = [path for path in recover(folder) if _set_name(path) == short]
    if left and not (mend or unique):
        raise _unfinished_error(folder / name, left[0])
    folder_lock = _claimed(folder, short, unique)
    try:
        yield FileSet(
            folder, folder_lock, [path for path in left if path != folder_lock.folder], inputs
        )
    finally:
        with uninterrupted():
            if folder_lock.is_unfinished:
                folder_lock.release()  # the next command says so
            else:
                folder_lock.remove()


def _unfinished_error(path: Path, staging: Path) -> OutputError:
    return OutputError(
        f"{path}: is unfinished: a run that was killed has put only some of its files in place",
        "run segment, or the command that made it, again with --overwrite, which makes all of them anew; the others "
        f"are in {staging}",
    )


def _claimed(folder: Path, short: str, unique: bool) -> _FolderLock:
    """Make a staging folder that is this process's alone, or take that of a dead one.

    Raises
    ------
    OutputError
        When another process has it.
    """
    if is_staging(folder):  # all in it is this process's
        return _unsealed(folder, short)
    reason = seals.unavailable()
    for _ in range(0 if reason else _TRIES):
        salt = secrets.token_hex(4) if unique else _ALONE
        staging = folder / _staging_name(folder, short, salt)
        with suppress(FileExistsError):
            os.mkdir(staging)
        if not is_sealed(folder, staging):
            reason = f"{staging.name} is no folder of this program"
            break
        try:
            if (lock := _locked(staging)) is not None:
                return _FolderLock(staging, lock)
        except FileNotFoundError:  # who looked if its writer is dead has removed it
            folder.stat()
        except OSError as error:
            _FolderLock(staging).remove()
            reason = error.strerror or str(error)
            break
        time.sleep(_TRY_SECONDS)
    if not reason:
        raise OutputError(
            f"{folder / short}: another run is writing there now",
            "wait until it ends, or choose another folder with -o",
        )
    if not unique:
        warnings.warn(
            f"{folder}: runs cannot be told apart ({reason}); if this one is killed, {PREFIX}{short}.*{SUFFIX} stays "
            "there, and a second one that writes the same files is not kept out. Set XDG_STATE_HOME to a folder that "
            "only you can write",
            AccelsurfWarning,
            stacklevel=4,
        )
    return _unsealed(folder, short)


def _unsealed(folder: Path, short: str) -> _FolderLock:
    """A staging folder that no other process knows anything of."""
    staging = folder / f".{short}.{secrets.token_hex(12)}.accelsurf"
    os.mkdir(staging)
    return _FolderLock(staging)


def recover(folder: Path) -> list[Path]:
    """Remove new files that killed processes of this user have left in a folder; those that live are left alone.

    Returns
    -------
    list of Path
        Staging folders of sets that are unfinished.

    Warns
    -----
    AccelsurfWarning
        Of staging folders that are not of this user's runs.
    """
    if is_staging(folder):
        return []
    foreign, unfinished = [], []
    for path in _staging_folders(folder):
        if not is_sealed(folder, path):
            foreign.append(path.name)
            continue
        try:
            lock = _locked(path)
        except OSError:  # it has just ended, or cannot be told from one that lives
            continue
        if lock is None:
            continue
        folder_lock = _FolderLock(path, lock)
        if folder_lock.is_unfinished:
            unfinished.append(path)
            folder_lock.release()
        else:
            folder_lock.remove()
    _name_foreign(folder, foreign)
    return unfinished


def is_unfinished(folder: Path, name: str) -> bool:
    """Test if a killed process of this user has put only some files of a set in place."""
    if not folder.is_dir():
        return False
    return _FolderLock(folder / _staging_name(folder, _short(name), _ALONE)).is_unfinished


def refuse_unfinished(folder: Path) -> None:
    """Refuse to read results in a folder with an unfinished set; see `recover`.

    Raises
    ------
    OutputError
        With its name.
    """
    if left := recover(folder):
        raise _unfinished_error(folder / _set_name(left[0]), left[0])


def _staging_folders(folder: Path) -> list[Path]:
    """Entries that have the name of a staging folder, files and links too."""
    try:
        return sorted(
            path
            for path in folder.iterdir()
            if path.name.startswith(PREFIX) and path.name.endswith(SUFFIX) and path.name != SUFFIX
        )
    except OSError:
        return []


def _name_foreign(folder: Path, names: list[str]) -> None:
    """Warn of staging folders without the seal of this user: whoever left them, nothing in them counts."""
    names = [name for name in names if os.path.lexists(folder / name)]
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        said = f"{', '.join(names[:_NAMED])}{more} {'are' if len(names) > 1 else 'is'} not from a run of yours"
        warnings.warn(
            f"{folder.absolute()}: {said}, so nothing in it is used or changed; remove it if nobody is writing there",
            AccelsurfWarning,
            stacklevel=3,
        )


def is_staging(folder: Path) -> bool:
    """Test if a folder is, or lies in, a staging folder.

    Examples
    --------
    >>> is_staging(Path("out/.scan.0123456789abcdef01234567.accelsurf/new")), is_staging(Path("out/new"))
    (True, False)
    """
    return any(_STAGING.fullmatch(part) for part in folder.parts)


def _staging_name(folder: Path, short: str, salt: str) -> str:
    """Name of a staging folder; nobody without the user's key can make one that is taken for the program's."""
    inode = folder.stat().st_ino  # a copy of the folder is another one
    sealed = seals.signed(b"staging", str(inode).encode(), salt.encode(), os.fsencode(short))
    return f"{PREFIX}{short}.{salt}{sealed[:16]}{SUFFIX}"


def is_sealed(folder: Path, path: Path) -> bool:
    """Test if a run of this user has made a staging folder here; that nothing else lies in its place."""
    found = _STAGING.fullmatch(path.name)
    return (
        found is not None
        and not seals.unavailable()
        and not _is_link(path)
        and path.name == _staging_name(folder, found["name"], found["salt"])
        and not (path.exists() and not path.is_dir())
        and not any(_is_link(path / inner) for inner in (_NEW, _OLD, _AGAIN))
    )


def _set_name(staging: Path) -> str:
    """The name of the set of a staging folder, shortened where it is long."""
    found = _STAGING.fullmatch(staging.name)
    return "" if found is None else found["name"]


def _short(name: str) -> str:
    """The name of a set in that of its staging folder, which any file system can take.

    Examples
    --------
    >>> _short("scan"), len(_short("x" * 255))
    ('scan', 57)
    """
    if len(os.fsencode(name)) <= _MAX_NAME_BYTES:
        return name
    return f"{name[:40]}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:16]}"


def _is_empty(folder: Path) -> bool:
    try:
        return not os.listdir(folder)
    except FileNotFoundError:
        return False


def _locked(staging: Path) -> int | None:
    """Return an open file in a staging folder that this process has locked; None where another process has.

    Raises
    ------
    OSError
        When the folder is gone, or its file system has no locks.
    """
    path = staging / _LOCK
    lock = os.open(path, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o600)
    try:
        if try_lock(lock) and os.path.samestat(os.fstat(lock), path.lstat()):
            return lock
    except BaseException:
        os.close(lock)
        raise
    os.close(lock)
    return None


def try_lock(lock: int) -> bool:
    """Lock an open file without waiting; an OSError where the file system has no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True


def refuse_links(folder: Path, hint: str = "") -> None:
    """Refuse to write in a folder that is a link, or that lies below one in the present folder.

    A link may have come with somebody's data, and lead anywhere. Links of the system, as /tmp is one on macOS, have not
    come so: they belong to root.

    Parameters
    ----------
    folder : Path
    hint : str, optional
        Advice, where the user does not name the folder.

    Raises
    ------
    OutputError
        With the folder that the link leads to.
    """
    whole, present = Path(os.path.abspath(folder)), Path.cwd()
    below = whole.relative_to(present).parts if whole.is_relative_to(present) else whole.parts[-1:]
    for count in range(len(below)):
        part = Path(*whole.parts[: len(whole.parts) - count])
        if _is_link(part) and not _is_of_the_system(part):
            raise OutputError(
                f"{part}: is a link to {os.path.realpath(part)}, and nothing is written through a link",
                hint or f"name the folder itself: {os.path.realpath(whole)}",
            )


def _is_of_the_system(link: Path) -> bool:
    return os.name == "posix" and link.lstat().st_uid == 0 and os.geteuid() != 0


def _is_link(path: Path) -> bool:
    """Test if a path is a link, or a junction of Windows."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISLNK(found.st_mode) or getattr(found, "st_reparse_tag", 0) == _JUNCTION


class InputFiles:
    """Files that a command reads, known by any name: that of a link, a hard link, or a folder above them.

    Parameters
    ----------
    paths : iterable of Path
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._known: dict[tuple[int, int], Path] = {}
        folders: dict[Path, Path] = {}
        for path in paths:
            self._put(path, path)
            folders.setdefault(path.absolute().parent, path)
            if path.is_symlink():
                folders.setdefault(path.resolve().parent, path)
        for folder, path in folders.items():  # the content of a folder goes with it
            for parent in {folder, *folder.parents, folder.resolve(), *folder.resolve().parents}:
                self._put(parent, path)

    def _put(self, found: Path, path: Path) -> None:
        if (status := _stat(found)) is not None:
            self._known.setdefault((status.st_dev, status.st_ino), path)

    def at(self, output: Path) -> Path | None:
        """The input that would be replaced or removed with a file or folder."""
        for status in (_stat(output), _stat(output, follow=False)):
            if status is not None and (status.st_dev, status.st_ino) in self._known:
                return self._known[status.st_dev, status.st_ino]
        return None

    def refuse(self, outputs: Iterable[Path], place: str = "folder with -o") -> None:
        """Refuse to replace or remove an input.

        Parameters
        ----------
        outputs : iterable of Path
        place : str, optional
            Another place to choose, for the hint.

        Raises
        ------
        OutputError
            With the input.
        """
        for output in outputs:
            if (given := self.at(output)) is not None:
                raise OutputError(
                    f"{output}: is read by this command (given as {given}), so it is not replaced or removed",
                    f"choose another {place}, or copy the input elsewhere and give the copy",
                )


def _stat(path: Path, follow: bool = True) -> os.stat_result | None:
    try:
        return path.stat() if follow else path.lstat()
    except OSError:
        return None


def sync(path: Path) -> None:
    """Wait until a file is on the disk, or all that is in a folder."""
    if path.is_dir():
        for inner in path.iterdir():
            sync(inner)
        sync_folder(path)
        return
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can say so."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError:
        pass  # some network file systems refuse it for folders
    finally:
        os.close(number)
