"""XML of files that may be hostile: without entities, which can name files and repeat without end."""

from __future__ import annotations

import io
from typing import IO, Any
from xml.etree import ElementTree

from accelsurf.errors import InputError

#: Bytes that are given to the parser at once.
_PART = 1 << 16


class NoEntities:
    """A target of a parser that refuses what defines entities."""

    def doctype(self, name: str, public_id: str | None, system: str | None) -> None:
        """Refuse a document type, which alone can define them."""
        raise InputError("entities in its XML, which no mesh needs", "export the mesh again")

    def close(self) -> Any:
        """Return what was built; nothing here."""
        return None


class _Tree(NoEntities, ElementTree.TreeBuilder):
    """Builds a tree of elements."""

    def close(self) -> ElementTree.Element:
        return ElementTree.TreeBuilder.close(self)


def feed(stream: IO[bytes], target: NoEntities) -> Any:
    """Give a file to a parser, part by part.

    Parameters
    ----------
    stream : file
        Open for reading.
    target : NoEntities
        With the methods ``start``, ``data`` or ``end`` that a target of `xml.etree.ElementTree.XMLParser` may have.

    Returns
    -------
    object
        What its ``close`` returns.

    Raises
    ------
    InputError
        When it has a document type.
    ElementTree.ParseError
        When it is damaged.
    """
    parser = ElementTree.XMLParser(target=target)
    while part := stream.read(_PART):
        parser.feed(part)
    return parser.close()


def parsed(text: bytes) -> ElementTree.Element:
    """Return the root of an XML text; errors as of `feed`."""
    root: ElementTree.Element = feed(io.BytesIO(text), _Tree())
    return root
