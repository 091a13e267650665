"""Places of the tiles in the picture: four up, one large and the others beside it, slices alone, one alone.

    four           one               slices            single
    +----+----+    +-------+---+    +---+---+---+    +-----------+
    | ax | co |    |       | . |    |   |   |   |    |           |
    +----+----+    | large | . |    | a | c | s |    |   large   |
    | sa | 3D |    |       | . |    |   |   |   |    |           |
    +----+----+    +-------+---+    +---+---+---+    +-----------+

The chart of the energies takes the place of a tile where there is one to spare, otherwise a strip below.
"""

from __future__ import annotations

from accelsurf.errors import check_known

LAYOUTS = ("one", "four", "slices", "single")
#: Part of the height that the chart takes where it is a strip.
STRIP = 0.2
#: Part of the width that the large tile takes beside others.
LARGE = 0.6

#: A slice beside the large tile is readable in a tile of this many pixels of a usual screen along its shorter side.
READABLE = 300

#: Left, bottom, right, top in the picture, each from 0 to 1.
Viewport = tuple[float, float, float, float]


def viewports(layout: str, tiles: tuple[str, ...], large: str, chart: bool) -> dict[str, Viewport]:
    """Return the place of each tile that is shown, and of ``energies``, the chart, if it is.

    Parameters
    ----------
    layout : str
        One of `LAYOUTS`.
    tiles : tuple of str
        All that there are, slices first; an image of one slice has one.
    large : str
        The tile that ``one`` and ``single`` show large.
    chart : bool
        Whether the chart is shown.

    Raises
    ------
    UsageError
        For another layout.

    Examples
    --------
    >>> viewports("single", ("axial", "coronal", "sagittal", "space"), "axial", False)
    {'axial': (0.0, 0.0, 1.0, 1.0)}
    >>> viewports("slices", ("axial",), "axial", True)
    {'axial': (0.0, 0.0, 0.75, 1.0), 'energies': (0.75, 0.0, 1.0, 1.0)}
    """
    check_known("layout", layout, LAYOUTS)
    if len(tiles) == 1:
        width = 0.75 if chart else 1.0
        return {tiles[0]: (0.0, 0.0, width, 1.0), **({"energies": (0.75, 0.0, 1.0, 1.0)} if chart else {})}
    if layout == "one":
        return _one(tiles, large, chart)
    floor = STRIP if chart else 0.0
    strip: dict[str, Viewport] = {"energies": (0.0, 0.0, 1.0, STRIP)} if chart else {}
    match layout:
        case "single":
            return {large: (0.0, floor, 1.0, 1.0), **strip}
        case "slices":
            slices = [name for name in tiles if name != "space"]
            n = len(slices)
            return {name: (i / n, floor, (i + 1) / n, 1.0) for i, name in enumerate(slices)} | strip
        case _:
            middle = 0.5 * (floor + 1.0)
            places = [
                (0.0, middle, 0.5, 1.0), (0.5, middle, 1.0, 1.0), (0.0, floor, 0.5, middle), (0.5, floor, 1.0, middle)
            ]
            return dict(zip(tiles, places, strict=False)) | strip


def fitting(width: float, height: float) -> tuple[str, bool]:
    """Return the layout that a picture begins with, and whether with the chart: four alike where it is small.

    Parameters
    ----------
    width, height : float
        Pixels of a usual screen.

    Examples
    --------
    >>> fitting(1602, 980), fitting(962, 640)
    (('one', True), ('four', False))
    """
    return ("one", True) if min(0.25 * width, 0.5 * height) >= READABLE else ("four", False)


def _one(tiles: tuple[str, ...], large: str, chart: bool) -> dict[str, Viewport]:
    """The large tile at the left; the others beside it, two by two with the chart, or in a column without."""
    others = [name for name in tiles if name != large]
    if chart:
        places = [(0.5, 0.5, 0.75, 1.0), (0.75, 0.5, 1.0, 1.0), (0.5, 0.0, 0.75, 0.5), (0.75, 0.0, 1.0, 0.5)]
        return {large: (0.0, 0.0, 0.5, 1.0), **dict(zip([*others, "energies"], places, strict=False))}
    n = len(others)
    column = {name: (LARGE, 1.0 - (i + 1) / n, 1.0, 1.0 - i / n) for i, name in enumerate(others)}
    return {large: (0.0, 0.0, LARGE, 1.0), **column}
