"""Opening of images: by name, from the list of recent files, from a folder; read in a thread, with questions first.

It exists before any image is open, and outlives each. Window and page pass on requests, show `state()`, and take the
image from `fetch()`: then they begin another session.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.keeping import Keeper
from accelsurf.viewer.actions.tool import carry_out, text, whole, word
from accelsurf.viewer.core.command_queue import in_background
from accelsurf.viewer.core.opening import (
    Choice,
    OpenedImage,
    ServedFolder,
    for_another_image,
    make_phantom,
    phantom_texts,
    read_image,
    read_path,
    read_reference,
    read_unsaved,
)
from accelsurf.viewer.core.recent_files import RecentFiles
from accelsurf.viewer.core.session import CHECKPOINT_MB, Session
from accelsurf.viewer.core.status import error_line
from accelsurf.viewer.core.unsaved import Unsaved

#: Seconds that a session has at the end of the program to end its step, the same after a signal, and to finish a save.
STEP_SECONDS = 10.0
HURRIED_SECONDS = 0.5
SAVING_SECONDS = 600.0
#: Letters of a path that a page sends, and of a message.
MAX_PATH = 1024
MAX_MESSAGE = 300
#: Answers to a question, and the words of their buttons.
ANSWERS = {
    "open": "Open",
    "reference": "As a reference",
    "resume": "Go on",
    "save": "Save",
    "discard": "Discard",
    "later": "Not now",
    "cancel": "Cancel",
}


@dataclass(frozen=True)
class ViewerSettings:
    """Settings of window and page, the same for each image.

    Attributes
    ----------
    folder : Path or None
        Where results are saved; None: the window asks for it the first time, a page takes a temporary one.
    theme : str
        "dark" or "light".
    overwrite : bool
        Replace files in the folder that a session has not written.
    checkpoint_mb : float
        Memory for stored steps, MB.
    """

    folder: Path | None = None
    theme: str = "dark"
    overwrite: bool = False
    checkpoint_mb: float = CHECKPOINT_MB


class Opening:
    """Opens images, phantoms and references.

    Parameters
    ----------
    config : RunConfig
        Settings of the first image; those that belong to one image are left out for the next.
    recent : RecentFiles
        Lists opened images.
    served : ServedFolder, optional
        Only paths in it can be asked for by name, as a page may; without it any path, as a person at the window may.

    Attributes
    ----------
    actions : Actions or None
        Of the image that is open now.
    message : str
        One line: the work in progress, or the last error.
    failed : bool
        Whether that is an error.
    closing : str
        Task of the window before it closes: "save" or "discard"; empty while it stays.
    """

    def __init__(
        self, config: RunConfig, recent: RecentFiles, served: ServedFolder | None = None
    ) -> None:
        self.actions: Actions | None = None
        self.message, self.failed = "", False
        self._config = config
        self._recent = recent
        self._served = served
        self._hints = recent.hints
        self._sessions = recent.unsaved
        self._keeper: Keeper | None = None
        #: Whether the start page has offered unsaved sessions, whatever their image.
        self._has_offered = False
        self.closing: Literal["", "save", "discard"] = ""
        self._work: Future[Any] | None = None
        self._began, self._doing = 0.0, ""
        self._choices: list[Choice] = []
        #: Actions of the answers to the question, by their names; its words.
        self._asked: dict[str, Callable[[], None]] = {}
        self._question = ""
        self._folder = served.root if served is not None else None
        self._phantoms = phantom_texts()
        self._lists: dict[str, Any] = {}
        #: Sessions of images that were left, with the seconds that each has at the end; how many images were opened.
        self._former: list[tuple[Session, float]] = []
        self._step_seconds = STEP_SECONDS
        self._opened = 0
        self._requests = dict(self.requests())
        self._renew_lists()

    # -- to ask -------------------------------------------------------------------------------------------

    def requests(self) -> Mapping[str, Callable[..., None]]:
        """Return the requests by name; values come from a page and are not trusted."""
        return {
            "open": lambda path: self.open_path(self._named(path)),
            "open_recent": self._open_recent,
            "open_phantom": self._open_phantom,
            "open_reference": lambda path: self.open_reference(self._named(path)),
            "choose": self._choose,
            "answer": self._answer,
            "list_folder": self._list_folder,
            "hints_off": self._hints.turn_off,
            **({} if self._served is not None else {"drop": self._open_dropped}),
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the requests that there are."""
        return tuple(self._requests)

    def request(self, name: Any, *values: Any) -> None:
        """Carry out a request; its error becomes `message`. Raises nothing."""
        try:
            carry_out(self._requests, name, values)
        except Exception as error:
            self._fail(error)

    def open_path(self, path: Path, dropped: bool = False) -> None:
        """Open an image, after questions where there are some: whether it is one that was dropped, which of several.

        Parameters
        ----------
        path : Path
        dropped : bool
            It may be meant as a reference, too.

        Raises
        ------
        UsageError
            When something is being opened already.
        """
        config, results = self._config, self._served is None
        self._ask_first(
            path.name or str(path),
            f"reading {path.name}",
            lambda: read_path(path, config, results),
            partial(self.open_reference, path) if dropped else None,
        )

    def open_reference(self, path: Path) -> None:
        """Compare the open image with labels.

        Raises
        ------
        UsageError
            When no image is open, or something is being opened already.
        """
        self._check_free()
        if self.actions is None:
            raise UsageError("reference: no image is open", "open the image first")
        geometry = self.actions.scene.geometry
        self._start(f"reading the reference {path.name}", lambda: read_reference(path, geometry))

    def _named(self, value: Any) -> Path:
        """The path that was asked for by name."""
        name = text(value, MAX_PATH)
        if not name:
            raise UsageError("open: nothing was given", "give the name of a file or folder")
        return self._served.resolve(name) if self._served is not None else Path(name).expanduser()

    def _open_recent(self, number: Any) -> None:
        entries = self._recent.entries()
        if not entries:
            raise UsageError("recent files: there are none")
        self.open_path(entries[whole(number, 0, len(entries) - 1)].path)

    def _open_phantom(self, name: Any) -> None:
        known, config = word(name, tuple(self._phantoms)), self._config
        self._ask_first(known, f"making the phantom {known}", lambda: make_phantom(known, config))

    def _choose(self, number: Any) -> None:
        if not self._choices:
            raise UsageError("choose: there is nothing to choose from")
        choice = self._choices[whole(number, 0, len(self._choices) - 1)]
        config, self._choices = self._config.replace(**choice.settings), []
        self._start(f"reading {choice.path.name}", lambda: read_image(choice.path, config))

    def _answer(self, answer: Any) -> None:
        asked = {**self._asked, "cancel": lambda: self.say("")}
        self._choices = [] if answer == "cancel" else self._choices
        work = asked[word(answer, tuple(asked))]
        self._asked, self._question = {}, ""
        work()

    def _list_folder(self, name: Any) -> None:
        if self._served is None:
            raise UsageError("list_folder: there is no folder to choose from")
        folder = self._served.resolve(text(name, MAX_PATH))
        self._served.entries(folder)  # raises where there is none
        self._folder = folder
        self._renew_lists()
        self.say("")

    def _open_dropped(self, *names: Any) -> None:
        """Open a file or folder dropped on the window."""
        if len(names) != 1:
            raise UsageError(
                f"{len(names)} files were dropped, one expected", "drop the folder of a scan"
            )
        self.open_path(self._named(names[0]), dropped=True)

    # -- to do --------------------------------------------------------------------------------------------

    def _check_free(self) -> None:
        if self._work is not None:
            raise UsageError(
                f"something else is being opened: {self._doing}", "wait until it is open"
            )

    def _ask_first(
        self,
        name: str,
        doing: str,
        work: Callable[[], Any],
        as_reference: Callable[[], None] | None = None,
    ) -> None:
        """Open an image at once, or when the question is answered: unsaved work would be lost.

        ``as_reference`` is offered too, where an image is open.
        """
        self._check_free()
        self._choices = []
        then: dict[str, Callable[[], None]] = {"open": partial(self._start, doing, work)}
        if as_reference is not None and self.actions is not None:
            then["reference"] = as_reference
        elif not self.is_unsaved:
            return then["open"]()
        loss = "; what was done here and is not saved will be lost" if self.is_unsaved else ""
        self._asked, self._question = then, f"Open {name}{loss}?"
        return self.say("")

    def _start(self, doing: str, work: Callable[[], Any]) -> None:
        """Begin work in a thread; `fetch` takes its result."""
        self._check_free()
        self._doing, self._began = doing, time.monotonic()
        self.say(f"{doing} ...")
        self._work = in_background(work, "accelsurf opening")

    def fetch(self) -> OpenedImage | None:
        """Return the image that has been read, once; None while there is none. Errors become `message`.

        Called again and again: unsaved work is kept then, and kept sessions are offered.
        """
        self._store()
        if self._work is None:
            return None
        if not self._work.done():
            seconds = time.monotonic() - self._began
            self.say(f"{self._doing} ..." + (f" {seconds:.0f} s" if seconds >= 1.0 else ""))
            return None
        work, self._work = self._work, None
        try:
            found = work.result()
        except Exception as error:
            self._fail(error)
            return None
        self.say("")
        if isinstance(found, OpenedImage):
            return found
        if isinstance(found, Volume):
            self._compare(found)
        else:
            self._choices = list(found)
        return None

    def _compare(self, labels: Volume) -> None:
        if self.actions is None:
            return
        try:
            self.actions.scene.compare(labels)
        except AccelsurfError as error:
            self._fail(error)

    def results_of_next(self, folder: Path | None, name: str) -> Path | None:
        """Return the folder for the results of the image that is opened next: the first has the folder itself, each
        further one a folder in it, by its name; None where the user is asked for one.
        """
        self._opened += 1
        return folder if folder is None or self._opened == 1 else folder / f"{name}-{self._opened}"

    def show(self, actions: Actions, opened: OpenedImage) -> None:
        """Note that an image that was read is shown; the session of the former one ends, without waiting for it."""
        if self.actions is not None:
            self._end(self.actions)
        if self._keeper is not None:
            self._keeper.forget()  # a person has said so
        self._keeper = Keeper(self._sessions, actions, opened)
        self.actions = actions
        self._config = for_another_image(self._config)
        if opened.source is not None:
            self._recent.add(opened.source)
        self._renew_lists()
        if opened.note:
            actions.note(opened.note, 30.0)

    def _end(self, actions: Actions) -> None:
        is_saving = actions.feature(FilesFeature).is_saving
        actions.session.close(0.0)
        self._former = [former for former in self._former if former[0].is_alive]
        self._former.append((actions.session, SAVING_SECONDS if is_saving else self._step_seconds))

    def hurry(self) -> None:
        """Let `close` wait for no step: a program that a signal ends has nothing more to compute."""
        self._step_seconds = HURRIED_SECONDS

    def close(self) -> None:
        """End all sessions, and wait until they have finished their commands.

        Unsaved work is kept for the next start, unless it was discarded.
        """
        if self._keeper is not None and self.closing == "discard":
            self._keeper.forget()
        elif self._keeper is not None:
            self._keeper.store(at_once=True)
        if self.actions is not None:
            self._end(self.actions)
        for session, seconds in self._former:
            session.close(seconds)

    # -- unsaved work -------------------------------------------------------------------------------------

    @property
    def is_unsaved(self) -> bool:
        """Test if something was done in the open image that no file has."""
        return self.actions is not None and self.actions.feature(FilesFeature).is_unsaved

    @property
    def is_stored(self) -> bool:
        """Test if unsaved work can be continued at the next start."""
        return self.is_unsaved and self._keeper is not None and self._keeper.is_stored

    @property
    def last_words(self) -> str:
        """Line for the program's end: the work that is kept, and how to go on."""
        keeper = self._keeper
        if keeper is None or not self.is_unsaved:
            return "nothing was unsaved"
        name = keeper.opened.name
        if self.is_stored:
            return f"what was not saved of {name} is kept: the next accelsurf view offers it"
        return f"what was not saved of {name} is lost{keeper.trouble and ': '}{keeper.trouble}"

    def may_close(self) -> bool:
        """Test if the window may close at once; else the person is asked, and the answer is `closing`."""
        if not self.is_unsaved or self.actions is None or self.closing == "discard":
            return True
        if self.actions.feature(FilesFeature).is_saving:
            self.closing = "save"
        elif not self._question and not self.closing:
            self._choices = []
            self._asked = {"save": partial(self._close, "save")}
            self._asked["discard"] = partial(self._close, "discard")
            self._question = f"Save what was done in {self.actions.session.name}?"
        return False

    def _close(self, closing: Literal["save", "discard"]) -> None:
        self.closing = closing

    def stay(self) -> None:
        """Close no more: saving has failed."""
        self.closing = ""

    def _store(self) -> None:
        """Keep unsaved work, and offer kept sessions, of this image, or on the start page of any."""
        if self._keeper is not None:
            self._keeper.store()
        if self._question or self._choices or self.is_busy or self.closing:
            return
        if self._keeper is not None:
            self._offer(self._keeper.found())
        elif not self._has_offered:
            self._has_offered = True
            self._offer(next(filter(self._can_open, self._sessions.entries()), None))

    def _can_open(self, unsaved: Unsaved) -> bool:
        """Test if the image of a session that was not saved is there, and may be opened."""
        path = unsaved.path
        if path is None or not os.path.exists(path):
            return False
        return self._served is None or path.resolve().is_relative_to(self._served.root.resolve())

    def _offer(self, unsaved: Unsaved | None) -> None:
        if unsaved is None:
            return
        self._asked = {
            "resume": partial(self._go_on, unsaved),
            "discard": partial(self._discard_one, unsaved),
            "later": lambda: None,
        }
        loss = "; what was done here since then will be lost" if self.is_unsaved else ""
        self._question = f"{unsaved.line}. Go on with it{loss}?"

    def _go_on(self, unsaved: Unsaved) -> None:
        """Go on with a session that was not saved: in the open image, or after its image has been read."""
        path = unsaved.path
        if self._keeper is not None:
            again = replace(
                self._keeper.opened, config=unsaved.config, unsaved=unsaved, is_result=False
            )
            self._opened -= 1  # it is the same image, with the same folder
            self._start("going on with what was not saved", lambda: again)
        elif path is not None:
            self._start(f"reading {path.name}", lambda: read_unsaved(unsaved, path))

    def _discard_one(self, unsaved: Unsaved) -> None:
        self._sessions.forget(unsaved.file)
        self._has_offered = False
        if self._keeper is not None:
            self._keeper.look_again()

    # -- to show ------------------------------------------------------------------------------------------

    @property
    def is_busy(self) -> bool:
        """Test if something is being opened."""
        return self._work is not None

    def state(self) -> dict[str, Any]:
        """Return the state to be shown, in types of JSON."""
        return {
            "is_open": self.actions is not None,
            "opening": self.is_busy,
            "opening_message": self.message,
            "opening_failed": self.failed,
            "question": self._question,
            "answers": [[name, ANSWERS[name]] for name in self._answers()],
            "choices": [choice.text for choice in self._choices],
            "hints": self._hints.lines,
            **self._lists,
        }

    def _answers(self) -> tuple[str, ...]:
        """Names of the answers to the question; the last one changes nothing."""
        if not self._question:
            return ()
        return (*self._asked, *(() if "later" in self._asked else ("cancel",)))

    def _renew_lists(self) -> None:
        """Renew the lists to choose from."""
        recent = [
            {"name": entry.path.name, "folder": str(entry.path.parent), "exists": entry.exists}
            for entry in self._recent.entries()
        ]
        phantoms = [{"name": name, "text": said} for name, said in self._phantoms.items()]
        self._lists = {
            "recent": recent,
            "phantoms": phantoms,
            "folder": "",
            "folders": [],
            "images": [],
            "above": None,
        }
        self._lists |= {"unlisted": 0, "this_image": ""}
        if self._served is None or self._folder is None:
            return
        entries, more = self._served.entries(self._folder)
        shown = self._served.shown(self._folder)
        inner = f"{shown}/" if shown else ""
        self._lists |= {
            "folder": shown or self._served.root.name,
            "above": self._served.shown(self._folder.parent) if shown else None,
            "folders": [[entry.name, inner + entry.name] for entry in entries if entry.is_folder],
            "images": [[entry.name, inner + entry.name] for entry in entries if entry.is_image],
            "unlisted": more,
            "this_image": (shown or ".") if self._served.is_image(self._folder) else "",
        }

    def say(self, line: str, failed: bool = False) -> None:
        """Show a line: on the start page, or beside the open image."""
        self.message, self.failed = line[:MAX_MESSAGE], failed
        if self.actions is not None:
            self.actions.note("" if failed else line, 600.0)
            if failed or line == "":
                self.actions.message = self.message

    def _fail(self, error: Exception) -> None:
        self.say(
            error.message
            if isinstance(error, UsageError) and not error.hint
            else error_line(error),
            failed=True,
        )
