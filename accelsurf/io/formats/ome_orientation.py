"""The anatomical orientation of the axes of an OME-Zarr (RFC-4 of OME-NGFF): words for the directions of a grid.

An axis says from which side of the patient to which its coordinates increase. The words for quadrupeds are taken as
DICOM places both kinds of patients: dorsal where posterior is, cranial and rostral where superior is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Floats

#: The field of an axis, and what drafts of RFC-4 called it.
_FIELDS = ("orientation", "anatomicalOrientation", "anatomical_orientation")
#: Sides towards which x, y and z of the world (LPS) increase, and those that they come from.
_SIDES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))
_QUADRUPED = {
    **{"dorsal": "posterior", "ventral": "anterior"},
    **{"cranial": "superior", "rostral": "superior", "caudal": "inferior"},
}
_HINT = "correct the orientation of the axes in the metadata of the store, or remove it from all of them"


def word_of(axis: Mapping[str, Any]) -> str:
    """The orientation that an axis says it has, as RFC-4 spells it; empty where it says none.

    Raises
    ------
    InputError
        When it says two.

    Examples
    --------
    >>> word_of({"name": "x", "orientation": {"type": "anatomical", "value": "left-to-right"}})
    'left-to-right'
    >>> word_of({"name": "x", "anatomicalOrientation": "LEFT_TO_RIGHT"})
    'left-to-right'
    """
    words = {_word(axis[field]) for field in _FIELDS if axis.get(field) is not None}
    if len(words) > 1:
        named = " and ".join(sorted(words))
        raise InputError(f"the axis {str(axis.get('name'))[:40]} of the OME-Zarr is oriented {named}", _HINT)
    return "".join(words)


def _word(given: Any) -> str:
    if isinstance(given, Mapping):
        kind, given = str(given.get("type", "anatomical")), given.get("value", "")
        if kind.lower() != "anatomical":
            return f"{kind[:40]} {str(given)[:40]}"
    spaced = re.sub("(?<=[a-z])(?=[A-Z])", "-", str(given)[:80])
    return re.sub(r"[\s_-]+", "-", spaced.strip()).lower()


def _line(word: str) -> tuple[int, float] | None:
    """The axis of the world that a word is along, and whether with it (1) or against it (-1)."""
    ends = tuple(_QUADRUPED.get(side, side) for side in word.split("-to-"))
    for axis, sides in enumerate(_SIDES):
        if ends in (sides, sides[::-1]):
            return axis, 1.0 if ends == sides else -1.0
    return None


def direction_of(axes: Sequence[tuple[str, str]]) -> tuple[Floats | None, list[str]]:
    """The directions of a grid by the orientation of its axes.

    Parameters
    ----------
    axes : sequence of (name, word)
        x, y and z of the array, or x and y, with what `word_of` gives.

    Returns
    -------
    tuple
        Directions (3, 3) as in `Geometry`, None where no axis has a known orientation; and what a person should know.

    Raises
    ------
    InputError
        When two axes are oriented along the same line of the body.
    """
    lines = [_line(word) for _, word in axes]
    known = [(line[0], name, word) for line, (name, word) in zip(lines, axes, strict=True) if line is not None]
    for number, (axis, name, word) in enumerate(known):
        for other_axis, other, other_word in known[:number]:
            if axis == other_axis:
                raise InputError(
                    f"the axes {other[:40]} ({other_word}) and {name[:40]} ({word}) of the OME-Zarr are oriented along "
                    "the same line of the body",
                    _HINT,
                )
    notes = [
        f"the orientation {word} of the axis {name[:40]} is no side of the body and not used"
        for line, (name, word) in zip(lines, axes, strict=True) if word and line is None
    ]
    if not known:
        return None, notes
    direction = np.zeros((3, 3))
    for column, line in enumerate(lines):
        if line is not None:
            direction[line[0], column] = line[1]
    for column in (column for column in range(3) if not direction[:, column].any()):
        free = [axis for axis in (column, 0, 1, 2) if not direction[axis].any()]
        direction[free[0], column] = 1.0
        if column < len(axes):
            taken = "-to-".join(_SIDES[free[0]])
            notes.append(f"the axis {axes[column][0][:40]} has no orientation, others have: it is taken as {taken}")
    if len(axes) == 2 and np.linalg.det(direction) < 0:
        direction[:, 2] *= -1.0  # the slice is seen from the side that makes the axes right-handed
    if any(side in _QUADRUPED for _, _, word in known for side in word.split("-to-")):
        notes.append(
            "the axes are oriented in words for animals: dorsal is taken as posterior, cranial and rostral as superior"
        )
    return direction, notes


def words_for(direction: Floats) -> list[str] | None:
    """The words for the axes x, y and z of a grid; None where it is oblique.

    Examples
    --------
    >>> words_for(np.diag([-1.0, -1.0, 1.0]))
    ['left-to-right', 'posterior-to-anterior', 'inferior-to-superior']
    """
    if not np.isin(direction, (-1.0, 0.0, 1.0)).all():
        return None
    axes = np.abs(direction).argmax(axis=0)
    return [
        "-to-".join(_SIDES[axis] if direction[axis, column] > 0 else _SIDES[axis][::-1])
        for column, axis in enumerate(axes)
    ]
