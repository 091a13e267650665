"""Files that belong together: they appear all at once or not at all, also when the process is killed.

Drafts lie in a hidden folder beside the outputs (`accelsurf.io.claims`). When all are complete and on the disk, a
journal with their names is put there: from this moment on the new files count. Then each old file is moved into the
hidden folder and each new one to its place. The last file, a report that names the others, is the first old one to go
and the last new one to come: where a report stands, its files are those that it names. Whoever finds the journal of a
dead process finishes the moves (`recover`). Drafts without a journal are removed.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from accelsurf.errors import OutputError
from accelsurf.io.claims import SUFFIX, Claim, claim, hidden_folders, hidden_name
from accelsurf.io.signals import uninterrupted

_JOURNAL = "journal.json"
_NEW, _OLD = "new", "old"
#: Another process looks for a moment whether the owner of a folder is dead, and holds its lock then.
_TRIES, _TRY_SECONDS = 10, 0.03


@dataclass(frozen=True)
class _Journal:
    """What is moved: ``files`` in their order, then ``last``; ``remove`` are old files; ``undo`` moves all back."""

    files: Sequence[str]
    remove: Sequence[str]
    last: str | None
    undo: bool = False


class FileSet:
    """Drafts of files that will stand in one folder; made by `opened`.

    Attributes
    ----------
    folder : Path
        Where the files will be.
    drafts : Path
        Where they are written, under their final names.
    committed : bool
        Whether they are in place, or will be put there by the next run.
    """

    def __init__(self, folder: Path, claimed: Claim) -> None:
        self.folder, self._claim = folder, claimed
        self.drafts = claimed.folder / _NEW
        self.committed = False
        self.discard()

    def discard(self) -> None:
        """Remove the drafts."""
        shutil.rmtree(self.drafts, ignore_errors=True)
        self.drafts.mkdir(exist_ok=True)

    def commit(self, last: str | None = None, remove: Iterable[str] = ()) -> None:
        """Put all drafts in place of the old files of their names. Signals wait until that is done.

        Parameters
        ----------
        last : str, optional
            The draft that names the others: no old one stands beside new files, and no new one beside old files.
        remove : iterable of str
            Names of old files that go; those of drafts and of files that are not there count for nothing.

        Raises
        ------
        OSError
            When a file cannot be put in place; then the old ones are there as before.
        """
        names = sorted(path.name for path in self.drafts.iterdir() if path.name != last)
        gone = [name for name in remove if name not in {*names, last} and os.path.lexists(self.folder / name)]
        for path in self.drafts.iterdir():
            sync(path)
        everything = names if last is None else [*names, last]
        with uninterrupted():
            if len(everything) == 1 and not gone and not self._has_folder(everything[0]):
                os.replace(self.drafts / everything[0], self.folder / everything[0])  # all or nothing by itself
            else:
                sync_folder(self.drafts)
                _write_journal(self._claim.folder, _Journal(names, gone, last))
                self.committed = True  # drafts must not be removed from here on, whatever happens
                try:
                    _move(self._claim.folder, self.folder)
                except Exception:
                    self.committed = (self._claim.folder / _JOURNAL).exists()
                    raise
            self.committed = True
            sync_folder(self.folder)


    def _has_folder(self, name: str) -> bool:
        """Whether the draft of a name, or what it replaces, is a folder: the system does not exchange these."""
        return (self.drafts / name).is_dir() or (self.folder / name).is_dir()


@contextmanager
def opened(folder: Path, name: str, unique: bool = False) -> Iterator[FileSet]:
    """Prepare a set of files. What a killed process has left of one is finished or removed first.

    Parameters
    ----------
    folder : Path
        Exists.
    name : str
        Of the set. Only one process at a time writes a set of this name.
    unique : bool
        Whether others may write one of this name at the same time: who ends last, wins.

    Raises
    ------
    OSError
        When nothing can be written there.
    OutputError
        When another process is writing this set, or what a killed one has begun cannot be finished.
    """
    stuck = recover(folder)
    hidden = folder / hidden_name(name)
    if not unique and hidden in stuck:
        raise OutputError(
            f"{folder / name}: a run that was killed has put only some of its files in place, and they cannot be moved",
            f"is one of them open in another program? the others are in {hidden}",
        )
    claimed = _claimed(hidden, unique)
    hidden = hidden if claimed is None else claimed.folder
    if claimed is None or (hidden / _JOURNAL).exists():  # its owner has died since
        if claimed is not None:
            claimed.release()
        raise OutputError(
            f"{folder / name}: another run is writing there now", "wait until it ends, or choose another folder with -o"
        )
    try:
        yield FileSet(folder, claimed)
    finally:
        with uninterrupted():
            if (hidden / _JOURNAL).exists():
                claimed.release()  # the next run tries again
            else:
                claimed.remove()


def _claimed(hidden: Path, unique: bool) -> Claim | None:
    """Claim a hidden folder, or a new one with a name like it; None where another process keeps it."""
    for _ in range(_TRIES):
        place = hidden
        if unique:
            place = Path(
                tempfile.mkdtemp(prefix=f"{hidden.name.removesuffix(SUFFIX)}.", suffix=SUFFIX, dir=hidden.parent)
            )
        claimed = claim(place, made=unique)
        if claimed is not None:
            return claimed
        time.sleep(_TRY_SECONDS)
    return None


def recover(folder: Path) -> list[Path]:
    """Finish or remove what killed processes have left in a folder; processes that live are left alone.

    Returns
    -------
    list of Path
        Hidden folders of sets that are complete but could not be put in place.
    """
    stuck = []
    for hidden in hidden_folders(folder):
        try:
            claimed = claim(hidden)
        except OSError:
            claimed = None
            if os.path.exists(hidden / _JOURNAL):  # False where one may not look
                stuck.append(hidden)
        if claimed is None:
            continue
        try:
            if (hidden / _JOURNAL).exists():
                with uninterrupted():
                    _move(hidden, folder)
        except (OSError, ValueError, TypeError, RecursionError):  # or the journal is none of ours
            stuck.append(hidden)
            claimed.release()
        else:
            claimed.remove()
    return stuck


def finish_killed_runs(folder: Path) -> None:
    """What a command does before it reads results in a folder: `recover`.

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


def _write_journal(hidden: Path, journal: _Journal) -> None:
    draft = hidden / f"{_JOURNAL}.draft"
    with draft.open("w", encoding="utf-8") as file:
        # Names that are no UTF-8 are escaped.
        file.write(json.dumps(asdict(journal)))
        file.flush()
        os.fsync(file.fileno())
    os.replace(draft, hidden / _JOURNAL)
    sync_folder(hidden)


def _read_journal(hidden: Path) -> _Journal:
    """The journal in a hidden folder; a ValueError where it would move files of other folders.

    A hidden folder may have come with somebody's data.
    """
    journal = _Journal(**json.loads((hidden / _JOURNAL).read_text(encoding="utf-8")))
    for name in (*journal.files, *journal.remove, *(() if journal.last is None else (journal.last,))):
        if name in ("", ".", "..") or os.path.basename(name) != name:
            raise ValueError(f"{name} is not the name of a file")
    return journal


def _move(hidden: Path, folder: Path) -> None:
    """Do what the journal says; a move that fails puts everything back. May be repeated after a kill at any point."""
    journal = _read_journal(hidden)
    (hidden / _OLD).mkdir(exist_ok=True)
    if not journal.undo:
        try:
            _move_forward(hidden, folder, journal)
        except Exception:
            journal = _Journal(journal.files, journal.remove, journal.last, undo=True)
            _write_journal(hidden, journal)
            _move_back(hidden, folder, journal)
            (hidden / _JOURNAL).unlink()
            raise
    else:
        _move_back(hidden, folder, journal)
    (hidden / _JOURNAL).unlink()


def _move_forward(hidden: Path, folder: Path, journal: _Journal) -> None:
    new, old = hidden / _NEW, hidden / _OLD
    last = [] if journal.last is None else [journal.last]
    for name in (*last, *journal.remove):
        if (name in journal.remove or os.path.lexists(new / name)) and os.path.lexists(folder / name):
            os.replace(folder / name, old / name)
    for name in (*journal.files, *last):
        if os.path.lexists(new / name):
            if os.path.lexists(folder / name):
                os.replace(folder / name, old / name)
            os.replace(new / name, folder / name)


def _move_back(hidden: Path, folder: Path, journal: _Journal) -> None:
    new, old = hidden / _NEW, hidden / _OLD
    last = [] if journal.last is None else [journal.last]
    for name in (*reversed(journal.files), *journal.remove, *last):
        placed = name not in journal.remove and not os.path.lexists(new / name)
        if placed and os.path.lexists(folder / name):
            os.replace(folder / name, new / name)
        if os.path.lexists(old / name):
            os.replace(old / name, folder / name)
