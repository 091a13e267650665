"""The zero level of psi in an image of one slice: closed contours in world mm, their length, and files of them.

Marching squares (scikit-image) on psi; the vertices lie so that the contours enclose the object's area, see
`vertex_placement`. As the mesh of a volume, a contour is closed also where the object is cut by the image's border: it
runs along the outer edges of the border pixels, half a pixel outside their centres, and that part counts in its length.

Shown as an image, with x to the right and y down, the object lies to the left of the direction in which a contour
runs: outer contours run counter-clockwise, hole contours clockwise. (In a slice across another axis, the last of its
two array axes is the one to the right.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage.measure import find_contours

from accelsurf.errors import EmptyResultError, InputError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.geometry import Geometry
from accelsurf.io import polydata, write_bytes
from accelsurf.measure.surface_mesh import NODE_MARGIN, writer_for
from accelsurf.measure.vertex_placement import balanced, on_edges


@dataclass(frozen=True, eq=False)
class Contours:
    """Closed curves in a plane of the world.

    Parameters
    ----------
    loops : tuple of ndarray, shape (n, 3), float64
        (x, y, z) in mm, LPS, of each curve's points in order; the last is joined to the first.

    Examples
    --------
    >>> import numpy as np
    >>> square = Contours((np.array([[0.0, 0, 0], [0, 2, 0], [2, 2, 0], [2, 0, 0]]),))
    >>> square.length, square.area
    (8.0, 4.0)
    """

    loops: tuple[Floats, ...]

    @cached_property
    def length(self) -> float:
        """Sum of the curves' lengths, mm."""
        return float(
            sum(
                np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1).sum()
                for loop in self.loops
            )
        )

    @cached_property
    def area(self) -> float:
        """Area of the object, mm2: the area within the outer curves less the holes."""
        total = np.zeros(3)
        for loop in self.loops:
            offsets = (
                loop - loop[0]
            )  # far from the world origin products of positions would lose digits
            total += np.cross(offsets, np.roll(offsets, -1, axis=0)).sum(axis=0) / 2
        return float(np.linalg.norm(total))

    def write(self, path: str | Path, space: str = "lps") -> None:
        """Write the contours, in one of the formats for them of `accelsurf.settings.file_formats`, by suffix.

        A .vtp has closed polylines. A CSV has the columns contour (counted from 0), x_lps_mm, y_lps_mm, z_lps_mm (or
        x_ras_mm, ...); the last row of a contour repeats its first.
        The file appears complete or not at all; an existing one is replaced.

        Parameters
        ----------
        path : str or Path
            The file to write.
        space : {"lps", "ras"}, optional
            Coordinates of the file.

        Raises
        ------
        UsageError
            For another suffix or space.
        OutputError
            When the file cannot be written.
        """
        writer, flip = writer_for(path, space, "contour", CONTOUR_WRITERS)
        write_bytes(Path(path), writer(tuple(loop * flip for loop in self.loops), space.upper()))


def extract_contours(psi: NDArray[np.float32], geometry: Geometry) -> Contours:
    """The contours psi = 0 of an image of one slice.

    Parameters
    ----------
    psi : ndarray, shape (nz, ny, nx), one of these 1
        Level-set function in mm, negative inside.
    geometry : Geometry
        Its grid.

    Returns
    -------
    Contours
        Closed, the object on their left; the same psi gives the same bytes.

    Raises
    ------
    EmptyResultError
        When no pixel is inside.
    InputError
        When psi is not of the grid's shape, has more than one slice, or is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> psi = np.full((1, 4, 5), -1.0, dtype=np.float32)
    >>> image = extract_contours(psi, Geometry((1, 4, 5), (7.0, 2.0, 1.0)))
    >>> image.area, image.length
    (40.0, 26.0)
    """
    axis = geometry.slice_axis
    if axis is None or psi.shape != geometry.shape:
        raise InputError(
            f"psi of shape {psi.shape} on a grid of {geometry.shape} given, one slice expected"
        )
    if not np.isfinite(psi).all():
        raise InputError("psi has NaN or infinite values, finite distances expected")
    if not (psi < 0).any():
        raise EmptyResultError(
            "no pixel is inside: there is no contour", hint="the object vanished; start larger"
        )
    return Contours(
        tuple(geometry.index_to_world(zyx) for zyx in _loops(psi, geometry.spacing, axis, 0))
    )


def in_slices(psi: NDArray[np.float32], geometry: Geometry) -> dict[int, Contours]:
    """The contours in which the slices across z cut the surface of a volume: where psi is 0 in each slice's plane.

    Parameters
    ----------
    psi : ndarray, shape (nz, ny, nx)
        Level-set function in mm, negative inside.
    geometry : Geometry
        Its grid.

    Returns
    -------
    dict of int to Contours
        By the index of the slice; slices without a voxel of the object are left out.

    Raises
    ------
    InputError
        When psi is not of the grid's shape or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> psi = np.ones((3, 4, 5), dtype=np.float32)
    >>> psi[1] = -1.0
    >>> {k: found.area for k, found in in_slices(psi, Geometry((3, 4, 5), (7.0, 2.0, 1.0))).items()}
    {1: 40.0}
    """
    if psi.shape != geometry.shape:
        raise InputError(f"psi of shape {psi.shape} on a grid of {geometry.shape} given")
    if not np.isfinite(psi).all():
        raise InputError("psi has NaN or infinite values, finite distances expected")
    inside = psi < 0
    # The placement of vertices looks at two further nodes on either side.
    box = bounding_box(inside, 4)
    if box is None:
        return {}
    part, first = psi[box], np.array([side.start for side in box])
    found = {}
    for k in np.flatnonzero(inside[box].any(axis=(1, 2))):
        loops = _loops(part, geometry.spacing, 0, int(k))
        found[int(k) + int(first[0])] = Contours(
            tuple(geometry.index_to_world(zyx + first) for zyx in loops)
        )
    return found


def _loops(
    psi: NDArray[np.float32], spacing: tuple[float, float, float], axis: int, k: int
) -> list[Floats]:
    """Index positions (n, 3) of the closed contours in slice ``k`` across ``axis``."""
    plane: Floats = np.take(psi, k, axis=axis).astype(np.float64)
    margin = NODE_MARGIN * min(step for a, step in enumerate(spacing) if a != axis)
    near = np.abs(plane) < margin
    plane[near] = np.where(plane[near] < 0, -margin, margin)
    # Two layers around the image, both at its outer edge: the inner one continues psi, the outer one is all outside.
    # The contour passes between them; as they lie at the same place, it runs along the edge.
    block = np.pad(np.pad(plane, 1, mode="edge"), 1, mode="edge")
    outermost = np.ones(block.shape, bool)
    outermost[1:-1, 1:-1] = False
    block[outermost] = np.abs(block[outermost])
    places = [np.concatenate([[-0.5, -0.5], np.arange(n), [n - 0.5, n - 0.5]]) for n in plane.shape]
    # "high": pixels that touch at a corner only are two objects, as they are where components are counted.
    found = find_contours(block, 0.0, fully_connected="high", positive_orientation="low")
    across = axis if psi.shape[axis] > 1 else None
    loops = []
    for nodes in found:
        rows, columns = (
            np.interp(nodes[:-1, a], np.arange(len(places[a])), places[a]) for a in (0, 1)
        )
        zyx = on_edges(
            np.insert(np.stack([rows, columns], axis=1), axis, float(k), axis=1),
            psi,
            spacing,
            margin,
        )
        zyx = zyx[(zyx != np.roll(zyx, -1, axis=0)).any(axis=1)]
        numbers = np.arange(len(zyx))
        sides = np.stack([numbers, np.roll(numbers, -1)], axis=1)
        loops.append(balanced(zyx, sides, psi, spacing, across))
    return loops


def vtp_bytes(loops: tuple[Floats, ...], space: str) -> bytes:
    """The bytes of a .vtp file; ``space`` is LPS or RAS."""
    ends = np.cumsum([len(loop) for loop in loops])
    lines = [
        [*range(end - len(loop), end), end - len(loop)]
        for end, loop in zip(ends, loops, strict=True)
    ]
    return polydata(
        np.concatenate(loops),
        np.concatenate(lines),
        ends + np.arange(1, len(ends) + 1),
        "Lines",
        space,
    )


def csv_bytes(loops: tuple[Floats, ...], space: str) -> bytes:
    """The bytes of a .csv file; ``space`` is LPS or RAS."""
    lines = [",".join(("contour", *(f"{axis}_{space.lower()}_mm" for axis in "xyz")))]
    for number, loop in enumerate(loops):
        lines += [f"{number},{x:.6f},{y:.6f},{z:.6f}" for x, y, z in (*loop, loop[0])]
    return ("\n".join(lines) + "\n").encode()


#: By the name of a format: of a tuple of loops (n, 3) in mm and "LPS" or "RAS", returns the bytes of a file.
CONTOUR_WRITERS = {"vtp": vtp_bytes, "csv": csv_bytes}
