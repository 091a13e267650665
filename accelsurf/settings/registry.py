"""Tables of entries by name, to which a program may add its own.

The command line, TOML files, the viewer, reports, ``accelsurf info`` and the reference pages read the tables, so an
entry that is added appears in all of them; add it before a command is first called, so that the help of its options
names it.
"""

from __future__ import annotations

from typing import Protocol, TypeVar


class Named(Protocol):
    """An entry of a table."""

    @property
    def name(self) -> str:
        """Its key."""
        ...


Entry = TypeVar("Entry", bound=Named)


def by_name(*entries: Entry) -> dict[str, Entry]:
    """Return a table of entries, in their order."""
    return {entry.name: entry for entry in entries}
