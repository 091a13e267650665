"""Space and unit in the header of a mesh: ``SPACE=RAS``, as 3D Slicer and accelsurf write it."""

from __future__ import annotations

import re
from typing import Any, Literal, NamedTuple

from numpy.typing import NDArray

from accelsurf.errors import InputError

#: The spaces that are understood, by their letters: the short and the long name.
_SPACES: dict[str, Literal["LPS", "RAS", ""]] = {
    "LPS": "LPS", "LEFTPOSTERIORSUPERIOR": "LPS", "RAS": "RAS", "RIGHTANTERIORSUPERIOR": "RAS",
}
_MILLIMETRES = ("MM", "MILLIMETER", "MILLIMETERS", "MILLIMETRE", "MILLIMETRES")
#: A colour space is none of the world.
_STATED = (
    r"(?<![\w-])(?<!color )(?<!colour ){name}[ \t]*=[ \t]*[\"']?[ \t]*"
    r"((?:left|right)[ _-]+(?:anterior|posterior)[ _-]+(?:superior|inferior)|[\w+-]++)(?![ \t]*=)"
)


class MeshContent(NamedTuple):
    """A mesh as its file has it.

    Attributes
    ----------
    points : ndarray (n, 3)
        mm, in the space that the header says, LPS where it says none.
    triangles : ndarray (m, 3)
        Point numbers.
    header : str
        What the file says of itself in comments and names, with ``SPACE=`` and ``UNIT=`` among it.
    """

    points: NDArray[Any]
    triangles: NDArray[Any]
    header: str = ""


def is_ras(header: str, given: str = "") -> bool:
    """Test if the points of a mesh are RAS, not LPS.

    Parameters
    ----------
    header : str
        What the file says of itself.
    given : {"", "lps", "ras"}
        What the user says. It counts where the header says nothing, or a space that is not understood.

    Raises
    ------
    InputError
        When the header and the user contradict each other, the header names several spaces or another one and the user
        none, or its unit is not mm.

    Examples
    --------
    >>> is_ras("3D Slicer output. SPACE=RAS"), is_ras("space = left-posterior-superior"), is_ras("", "ras")
    (True, False, True)
    """
    units = [word for word in _stated("UNIT", header) if word.upper() not in _MILLIMETRES]
    if units:
        raise InputError(f"its header says UNIT={units[0][:40]}, mm expected", "export the mesh in mm")
    space = stated_space(header)
    if space:
        if given and given.upper() != space:
            raise InputError(f"its header says SPACE={space}, @{given} was given", f"leave @{given} out")
        return space == "RAS"
    words = _stated("SPACE", header)
    if words and not given:
        said = " and ".join(dict.fromkeys(f"SPACE={word[:40]}" for word in words[:3]))
        raise InputError(
            f"its header says {said}, SPACE=LPS or SPACE=RAS expected",
            "say which it is, FILE@lps or FILE@ras, or export the mesh as LPS",
        )
    return given == "ras"


def stated_space(header: str) -> Literal["LPS", "RAS", ""]:
    """The space that a header says; empty where it says none, several, or one that is not understood."""
    spaces = {_SPACES.get("".join(re.findall("[A-Z]", word.upper())), "") for word in _stated("SPACE", header)}
    return spaces.pop() if len(spaces) == 1 else ""


def _stated(name: str, header: str) -> list[str]:
    """The words that a header gives after ``name =``."""
    return re.findall(_STATED.format(name=name), header, flags=re.IGNORECASE)
