"""How fine a mesh is: a number of triangles, or the length of their sides, as people write it."""

from __future__ import annotations

import math
import re
from typing import Any

from accelsurf.errors import UsageError

#: What ``--mesh-faces`` takes.
MESH_SIZE = r"\s*(?:[0-9]{1,10}|[0-9.]+(?:e-?[0-9]+)?\s*(?:mm|um))\s*"
_PARTS = re.compile(r"\s*([0-9.]+(?:e-?[0-9]+)?)\s*(mm|um)?\s*")


def mesh_size(text: str) -> tuple[int | None, float | None]:
    """The number of triangles, or the length of their sides in mm; the other is None.

    Raises
    ------
    UsageError
        For fewer than 4 triangles, no length, or another text.

    Examples
    --------
    >>> mesh_size("20000"), mesh_size("2mm"), mesh_size("500um")
    ((20000, None), (None, 2.0), (None, 0.5))
    """
    found = _PARTS.fullmatch(text)
    try:
        value = float(found.group(1)) if found else 0.0
    except ValueError:
        value = 0.0
    if found is not None and found.group(2) is not None and 0 < value < math.inf:
        return None, value * (1e-3 if found.group(2) == "um" else 1.0)
    if found is not None and found.group(2) is None and value >= 4 and value == int(value):
        return int(value), None
    raise UsageError(
        f"mesh_faces: {text[:40]} was given, expected a number of triangles of at least 4, or a length",
        "as 20000, or 2mm",
    )


def checked_mesh_size(value: Any) -> Any:
    """Check such a text; a number of triangles may be written as a number."""
    if isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    if isinstance(value, str):
        mesh_size(value)
    return value
