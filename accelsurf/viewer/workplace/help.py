"""The page of keys and mouse."""

from __future__ import annotations

from collections.abc import Mapping

from accelsurf.viewer.workplace.feature import Key

#: What the mouse does where.
MOUSE = (
    ("left in 3D", "turns"),
    ("left in a slice", "uses the tool; Look moves the slices through the point"),
    ("right in a slice", "grey values: sideways the width, up and down the level"),
    ("right in 3D", "zooms"),
    ("middle, or shift with left", "moves the picture"),
    ("wheel", "next slice; zooms in 3D; with Ctrl, or a pinch, zooms in a slice"),
    ("two fingers on a screen", "zoom and move what is under them"),
    ("double click", "with Look: this tile alone, and back"),
)


def help_rows(keys: Mapping[str, Key]) -> list[tuple[str, str]]:
    """Return what keys and mouse do, keys that do the same kind of thing in one row.

    Examples
    --------
    >>> help_rows({"V": Key("tool", ("look",), "look"), "S": Key("tool", ("size",), "size")})[0]
    ('V  S', 'look, size')
    """
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for key, does in keys.items():
        # Tools are one row of short words; other keys have a row each.
        names, texts = rows.setdefault("tool" if does.request == "tool" else key, ([], []))
        names.append(key)
        texts.append(does.text)
    return [("  ".join(names), ", ".join(texts)) for names, texts in rows.values()] + list(MOUSE)
