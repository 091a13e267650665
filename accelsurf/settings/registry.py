"""Registries: an ordered mapping from names to entries, to which a program may add its own.

The command line, TOML files, the viewer, reports, ``accelsurf info`` and the reference pages read the registries, so an
entry that is added here appears in all of them.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar


class Named(Protocol):
    """An entry of a registry."""

    @property
    def name(self) -> str:
        """Its key."""
        ...


Entry = TypeVar("Entry", bound=Named)


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Entries by name, in the order in which they were added.

    Parameters
    ----------
    noun : str
        Noun for an entry, for messages.
    *entries
        The built-in ones.
    """

    def __init__(self, noun: str, *entries: Entry) -> None:
        self._noun = noun
        self._entries: dict[str, Entry] = {}
        for entry in entries:
            self.register(entry)

    def __getitem__(self, name: str) -> Entry:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def register(self, entry: Entry) -> Registration:
        """Add an entry; add it before a command is first called, so that the help of its options names it.

        Parameters
        ----------
        entry
            With a name that is not taken.

        Returns
        -------
        Registration
            Removes the entry; as a context manager, at the end of the block. It may be ignored.

        Raises
        ------
        ValueError
            When the name is taken.
        """
        if entry.name in self._entries:
            raise ValueError(f"there is a {self._noun} {entry.name} already")
        self._entries[entry.name] = entry
        return Registration(self._entries, entry.name)


class Registration(AbstractContextManager["Registration"]):
    """Removes an entry again.

    Parameters
    ----------
    entries : dict
        The registry's entries.
    name : str
        Its name.
    """

    def __init__(self, entries: dict[str, Any], name: str) -> None:
        self._entries, self._name = entries, name

    def remove(self) -> None:
        """Remove the entry; a second call has no effect."""
        self._entries.pop(self._name, None)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.remove()


def load(target: str | Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that an entry names as ``"module:function"``; it is imported when it is first needed.

    Entries name their functions so that ``accelsurf --help`` does not import compiled code.

    Examples
    --------
    >>> load("math:sqrt")(4.0)
    2.0
    """
    if not isinstance(target, str):
        return target
    module, _, function = target.partition(":")
    made: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return made
