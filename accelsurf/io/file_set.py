"""Files that belong together: they appear all at once or not at all, also when the process is killed.

New files lie in a staging folder beside the outputs until all are complete and on the disk. Then a journal in the
user's state folder (`accelsurf.io.set_journals`) says what is moved: from this moment on the new files count. Each old
file is moved into the staging folder and each new one to its place. The last file, a report that names the others, is
the first old one to go and the last new one to come: where a report stands, its files are those that it names. The next
command finishes the moves of a dead process by its journal (`recover`), or removes the staging folder where none had
begun.
A staging folder without a journal of this user is named and left alone.
"""

from __future__ import annotations

import os
import shutil
import signal
import stat
import threading
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from accelsurf.errors import AccelsurfWarning, OutputError
from accelsurf.io import set_journals
from accelsurf.io.set_journals import PREFIX, SUFFIX, Journal, Moves, sync_folder

#: Signals that end a program on request.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_NEW, _OLD = "new", "old"
#: Another process looks for a moment whether the writer of a set is dead, and holds its lock then.
_TRIES, _TRY_SECONDS = 10, 0.03
#: What Windows calls a junction by: a link between folders.
_JUNCTION = 0xA0000003
#: Foreign staging folders that a warning names.
_NAMED = 3


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let both signals wait until the end of a short piece of work, such as some renames; then they act as before."""
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


class FileSet:
    """Staging files that will stand in one folder; made by `open_set`.

    Attributes
    ----------
    folder : Path
        Where the files will be.
    staging : Path
        The folder in which they are written, under their final names.
    committed : bool
        Whether they are in place, or will be put there by the next run.
    """

    def __init__(self, folder: Path, journal: Journal, inputs: Sequence[Path] = ()) -> None:
        self.folder, self._journal, self._inputs = folder, journal, inputs
        self.staging = journal.staging / _NEW
        self.committed = False
        os.mkdir(journal.staging)  # it is new: nothing that was put there before is followed
        os.mkdir(self.staging)

    def discard(self) -> None:
        """Remove the staging files."""
        shutil.rmtree(self.staging, ignore_errors=True)
        with suppress(
            FileNotFoundError
        ):  # somebody has removed the output folder: what is written next says so
            self.staging.mkdir(exist_ok=True)

    def commit(self, last: str | None = None, remove: Iterable[str] = ()) -> None:
        """Put all staging files in place of the old files of their names. Signals wait until that is done.

        Parameters
        ----------
        last : str, optional
            The file that names the others: no old one stands beside new files, and no new one beside old files.
        remove : iterable of str
            Names of old files that go; those of staging files and of files that are not there are ignored.

        Raises
        ------
        OSError
            When a file cannot be put in place; then the old ones are there as before.
        OutputError
            When one of the old files is an input of the run.
        """
        names = sorted(path.name for path in self.staging.iterdir() if path.name != last)
        gone = [
            name
            for name in remove
            if name not in {*names, last} and os.path.lexists(self.folder / name)
        ]
        InputFiles(self._inputs).refuse(
            self.folder / name for name in (*names, *gone, *([last] if last else []))
        )
        for path in self.staging.iterdir():
            sync(path)
        everything = names if last is None else [*names, last]
        with uninterrupted():
            if len(everything) == 1 and not gone and not self._has_folder(everything[0]):
                os.replace(
                    self.staging / everything[0], self.folder / everything[0]
                )  # all or nothing by itself
            else:
                sync_folder(self.staging)
                self._plan(Moves(names, gone, last))
                self.committed = (
                    True  # staging files must not be removed from here on, whatever happens
                )
                try:
                    _move(self._journal, self.folder)
                except Exception:
                    self.committed = self._journal.moves is not None
                    raise
            self.committed = True
            sync_folder(self.folder)

    def _plan(self, moves: Moves) -> None:
        """Have a journal of the moves; where none can be written, they are made without."""
        try:
            self._journal.write(moves)
        except OSError as error:
            self._journal.keep_in_memory(moves, error)
            _warn_without_journal(self.folder, self._journal)

    def _has_folder(self, name: str) -> bool:
        """Test if the staging file of a name, or what it replaces, is a folder: the system does not exchange these."""
        return (self.staging / name).is_dir() or (self.folder / name).is_dir()


@contextmanager
def open_set(
    folder: Path, name: str, unique: bool = False, inputs: Sequence[Path] = ()
) -> Iterator[FileSet]:
    """Prepare a set of files. What a killed process has left of one is finished or removed first.

    Parameters
    ----------
    folder : Path
        Exists.
    name : str
        Of the set. Only one process of this user at a time writes a set of this name.
    unique : bool
        Whether others may write one of this name at the same time: who ends last, wins.
    inputs : sequence of Path, optional
        Files that are not replaced or removed, under whatever name.

    Raises
    ------
    OSError
        When nothing can be written there.
    OutputError
        When another process is writing this set, what a killed one has begun cannot be finished, or the folder is a
        link.

    Warns
    -----
    AccelsurfWarning
        Of staging folders that are not of this user's runs, and of a state folder that cannot be written.
    """
    refuse_links(folder)
    stuck = [staging for staging in recover(folder) if set_journals.belongs_to(staging, name)]
    if stuck and not unique:
        raise OutputError(
            f"{folder / name}: a run that was killed has put only some of its files in place, and they cannot be moved",
            f"is one of them open in another program? the others are in {stuck[0]}",
        )
    journal = _begun(folder, name, unique)
    if journal is None:
        raise OutputError(
            f"{folder / name}: another run is writing there now",
            "wait until it ends, or choose another folder with -o",
        )
    if not (unique or journal.has_file or set_journals.is_staging(folder)):
        _warn_without_journal(folder, journal)
    try:
        yield FileSet(folder, journal, inputs)
    finally:
        with uninterrupted():
            if journal.moves is not None:
                journal.release()  # the next run tries again
            else:
                shutil.rmtree(journal.staging, ignore_errors=True)
                journal.end()


def _warn_without_journal(folder: Path, journal: Journal) -> None:
    warnings.warn(
        f"{folder}: no journal can be kept ({journal.reason}); if this command is killed while its files are put in "
        "place, some may be old and some new. Set XDG_STATE_HOME to a folder that only you can write",
        AccelsurfWarning,
        stacklevel=3,
    )


def _begun(folder: Path, name: str, unique: bool) -> Journal | None:
    for _ in range(_TRIES):
        journal = set_journals.begin_journal(folder, name, unique)
        if journal is not None:
            return journal
        time.sleep(_TRY_SECONDS)
    return None


def recover(folder: Path) -> list[Path]:
    """Finish or remove what killed processes of this user have left in a folder; those that live are left alone.

    Returns
    -------
    list of Path
        Staging folders of sets that are complete but could not be put in place.

    Warns
    -----
    AccelsurfWarning
        Of staging folders that no journal of this user names.
    """
    if set_journals.is_staging(folder):
        return []
    there, stuck = _staging_folders(folder), []
    for journal in set_journals.journals_of_the_dead(folder):
        try:
            _check_staging(journal)
            if journal.moves is not None:
                with uninterrupted():
                    _move(journal, folder)
            shutil.rmtree(journal.staging, ignore_errors=True)
        except OSError:
            stuck.append(journal.staging)
            journal.release()
        else:
            journal.end()
    _name_foreign(folder, there)
    return stuck


def _staging_folders(folder: Path) -> list[str]:
    """Names of what looks like staging folders, and of links that are called so."""
    try:
        names = os.listdir(folder)
    except OSError:
        return []
    return sorted(
        name
        for name in names
        if name.startswith(PREFIX) and name.endswith(SUFFIX) and name != SUFFIX
    )


def _name_foreign(folder: Path, there: list[str]) -> None:
    """Warn of staging folders of which no journal of this user tells: whoever left them, nothing in them counts."""
    if not there:
        return
    known = set_journals.recorded_staging(folder)
    names = [name for name in there if name not in known and os.path.lexists(folder / name)]
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        said = f"{', '.join(names[:_NAMED])}{more} {'are' if len(names) > 1 else 'is'} not from a run of yours"
        warnings.warn(
            f"{folder.absolute()}: {said}, so nothing in it is used or changed; remove it if nobody is writing there",
            AccelsurfWarning,
            stacklevel=3,
        )


def refuse_links(folder: Path, hint: str = "") -> None:
    """Refuse to write in a folder that is a link, or that lies below one in the present folder.

    A link may have come with somebody's data, and lead anywhere. Links of the system, as /tmp is one on macOS, have not
    come so: they belong to root.

    Parameters
    ----------
    folder : Path
    hint : str, optional
        What to do, of a folder that the user does not name.

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


def _check_staging(journal: Journal) -> None:
    """Refuse a staging folder in whose place somebody has put something else; one that is gone has nothing to move.

    Raises
    ------
    OSError
        When it, or a folder in it, is no folder.
    """
    for folder in (journal.staging, journal.staging / _NEW, journal.staging / _OLD):
        try:
            found = folder.lstat()
        except FileNotFoundError:
            continue
        if not stat.S_ISDIR(found.st_mode) or _is_link(folder):
            raise NotADirectoryError(f"{folder}: is no folder")


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
        for folder, path in folders.items():  # what lies in a folder goes with it
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
            What else to choose, for the hint.

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


def finish_killed_runs(folder: Path) -> None:
    """Recover a folder before results in it are read; see `recover`.

    Raises
    ------
    OutputError
        When the files there are not of one run and cannot be made so.
    """
    if stuck := recover(folder):
        raise OutputError(
            f"{folder}: a run that was killed has put only some of its files in place, and they cannot be moved",
            f"may the folder be written to, is one of them open elsewhere? the others are in {stuck[0]}",
        )


def sync(path: Path) -> None:
    """Wait until a file is on the disk, or all that is in a folder."""
    if path.is_dir():
        for inner in path.iterdir():
            sync(inner)
        sync_folder(path)
        return
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _move(journal: Journal, folder: Path) -> None:
    """Do what a journal says; a move that fails puts everything back. May be repeated after a kill at any point."""
    moves, staging = journal.moves, journal.staging
    if moves is None or not staging.is_dir():
        journal.clear()
        return
    (staging / _OLD).mkdir(exist_ok=True)
    if moves.undo:
        _move_back(staging, folder, moves)
    else:
        try:
            _move_forward(staging, folder, moves)
        except Exception:
            moves = replace(moves, undo=True)
            journal.write(moves)
            _move_back(staging, folder, moves)
            journal.clear()
            raise
    journal.clear()


def _move_forward(staging: Path, folder: Path, moves: Moves) -> None:
    new, old = staging / _NEW, staging / _OLD
    last = [] if moves.last is None else [moves.last]
    for name in (*last, *moves.remove):
        if (name in moves.remove or os.path.lexists(new / name)) and os.path.lexists(folder / name):
            os.replace(folder / name, old / name)
    for name in (*moves.files, *last):
        if os.path.lexists(new / name):
            if os.path.lexists(folder / name):
                os.replace(folder / name, old / name)
            os.replace(new / name, folder / name)


def _move_back(staging: Path, folder: Path, moves: Moves) -> None:
    new, old = staging / _NEW, staging / _OLD
    last = [] if moves.last is None else [moves.last]
    for name in (*reversed(moves.files), *moves.remove, *last):
        placed = name not in moves.remove and not os.path.lexists(new / name)
        if placed and os.path.lexists(folder / name):
            os.replace(folder / name, new / name)
        if os.path.lexists(old / name):
            os.replace(old / name, folder / name)
