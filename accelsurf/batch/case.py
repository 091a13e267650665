"""A case of a batch: an image with an id, and the settings that it alone has."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from accelsurf.errors import InputError
from accelsurf.settings.wording import escaped, shown

#: Characters that a file system or a shell does not take in a name.
_UNSAFE = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f]')
#: Names of the tables of a batch, which lie beside the folders of the cases.
_TABLES = re.compile(r"batch(_report)?(_\d+of\d+)?\.(csv|html|json)", re.IGNORECASE)
#: Of an id: names of files begin with it, and have 255 bytes on the usual file systems.
MAX_ID_BYTES = 160


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes
    ----------
    id : str
        Its name, and that of its folder and files.
    image : Path
    settings : mapping of str to (str or tuple of str)
        Settings of this case; they override the common ones. Text as it is typed.
    reference : Path or None
        Label map that the result is compared with.
    place : str
        Where it was found, for messages: a file, or a line of a table.
    problem : str
        Why it cannot be run: it is refused alone, and the others of the batch go on.
    """

    id: str
    image: Path
    settings: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    reference: Path | None = None
    place: str = ""
    problem: str = ""

    @property
    def channels(self) -> tuple[Path, ...]:
        """Files of its further channels, where it has some of its own."""
        given = self.settings.get("channel", ())
        return tuple(Path(path) for path in ((given,) if isinstance(given, str) else given))


def checked_ids(cases: Sequence[Case]) -> list[Case]:
    """Return cases whose ids are names of folders, each once; one whose file has an unsafe name says so as its problem.

    Letters that differ in case alone are the same on some file systems, so they count as the same here.

    Raises
    ------
    InputError
        When one is given twice; with the places of the cases.
    """
    cases = [_checked_id(case) for case in cases]
    count = Counter(case.id.casefold() for case in cases)
    twice = [case for case in cases if count[case.id.casefold()] > 1]
    if twice:
        places = [case.place for case in twice if case.id.casefold() == twice[0].id.casefold()]
        raise InputError(
            f"the id {shown(twice[0].id)} is given {len(places)} times: {places[0]} and {places[1]}",
            "each case needs an id of its own: a folder of this name is made for it",
        )
    return cases


def _checked_id(case: Case) -> Case:
    try:
        return check_id(case)
    except InputError as error:
        return replace(case, id=escaped(case.id) or "?", problem=escaped(error.message))


def check_id(case: Case) -> Case:
    """Refuse an id that is no name of a folder; return the case.

    Raises
    ------
    InputError
        With the place of the case.
    """
    name, hint = case.id, "letters, digits, . _ and - are safe; a table can give each image an id"
    if not name:
        raise InputError(f"{case.place}: the id is empty", hint)
    if (found := _UNSAFE.search(name)) is not None:
        raise InputError(
            f"{case.place}: the id {shown(name)} has {shown(found[0])}, which no folder can have",
            hint,
        )
    if name[0] in ".- " or name[-1] in ". ":
        raise InputError(
            f"{case.place}: the id {shown(name)} begins or ends with a sign that a folder cannot",
            hint,
        )
    if _TABLES.fullmatch(name):
        raise InputError(
            f"{case.place}: the id {shown(name)} is the name of a table of the batch", hint
        )
    try:
        size = len(name.encode())
    except UnicodeEncodeError:
        raise InputError(f"{case.place}: the id is not valid UTF-8", hint) from None
    if size > MAX_ID_BYTES:
        raise InputError(
            f"{case.place}: the id has {size} bytes, at most {MAX_ID_BYTES} expected", hint
        )
    return case
