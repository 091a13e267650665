"""The zero level of psi as a closed triangle mesh in world mm, its measures, and mesh files.

Marching cubes (Lewiner's, from scikit-image) runs on the bounding box of the inside voxels only. The mesh is closed
also where the object meets the volume's border: there it ends on the outer faces of the border voxels, half a voxel
outside their centres, with flat caps and sharp edges. A volume of one slice gives a prism one voxel thick.

World coordinates are LPS, as in ITK; RAS is (-x, -y, z), a rotation by 180 degrees about z (determinant +1), so
outward normals stay outward and no triangle has to be turned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from accelsurf.errors import EmptyResultError, InputError, UsageError
from accelsurf.grid.arrays import Faces, Floats
from accelsurf.grid.boxes import Box, bounding_box, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.io import glb_bytes, obj_bytes, ply_bytes, stl_bytes, vtp_bytes, write_bytes
from accelsurf.measure.vertex_placement import balanced, in_cells, on_edges
from accelsurf.settings.labels import LabelEntry
from accelsurf.settings.mesh_formats import MESH_FORMATS, Shape, mesh_formats

NODE_MARGIN = 1e-4
"""Values of psi closer to 0 than this part of the smallest voxel size are moved there, so that the surface passes
every voxel centre at a distance and no triangle collapses to a point or a line."""

SPACES = ("lps", "ras")
#: By the name of a format: of the vertices (n, 3) in mm, the triangles (m, 3), "LPS" or "RAS" and a LabelEntry or None,
#: returns the bytes of a file, without a label as without name and colour.
SURFACE_WRITERS: dict[str, Callable[..., bytes]] = {
    "ply": ply_bytes,
    "stl": stl_bytes,
    "obj": obj_bytes,
    "vtp": vtp_bytes,
    "glb": glb_bytes,
}


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh in world mm.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3), float64
        (x, y, z) in mm, LPS.
    faces : ndarray, shape (m, 3), int32
        Vertex numbers, counter-clockwise seen from outside: normals point outward.

    Examples
    --------
    >>> import numpy as np
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> tetrahedron = Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32))
    >>> round(tetrahedron.volume, 4), round(tetrahedron.area, 4), tetrahedron.is_closed
    (0.1667, 2.366, True)
    """

    vertices: Floats
    faces: Faces

    @cached_property
    def _corners(self) -> tuple[Floats, Floats, Floats]:
        # Relative to the middle: far from the world origin the volume's sum would lose digits to cancellation.
        v = self.vertices - self.vertices.mean(axis=0)
        return v[self.faces[:, 0]], v[self.faces[:, 1]], v[self.faces[:, 2]]

    @property
    def area(self) -> float:
        """Sum of the triangles' areas, mm2."""
        a, b, c = self._corners
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    @property
    def volume(self) -> float:
        """Enclosed volume, mm3, by the divergence theorem: sum of a . (b x c) / 6; positive when outward."""
        a, b, c = self._corners
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    @property
    def bounds(self) -> Floats:
        """Smallest and largest (x, y, z), shape (2, 3), mm LPS."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def is_closed(self) -> bool:
        """True if every edge is used as often in one direction as in the other: no holes, all facing one way."""
        start, end, n = *self._sides(), len(self.vertices)
        return bool(np.array_equal(np.sort(start * n + end), np.sort(end * n + start)))

    def _sides(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last vertex of every triangle side, in the triangle's sense."""
        return self.faces.astype(np.int64).ravel(), np.roll(self.faces, -1, axis=1).astype(
            np.int64
        ).ravel()

    def write(self, path: str | Path, space: str = "lps", label: LabelEntry | None = None) -> None:
        """Write a mesh file, in one of the formats for surfaces of `accelsurf.settings.file_formats`, by suffix.

        The file appears complete or not at all: it is written under a temporary name and renamed. An existing file
        is replaced. The coordinate space and the unit stand in the header (.vtp: in the field data).

        Parameters
        ----------
        path : str or Path
            The file to write.
        space : {"lps", "ras"}, optional
            Coordinates of the file. Normals point outward in both.
        label : LabelEntry, optional
            Its name and colour, which go into the file where its format keeps them.

        Raises
        ------
        UsageError
            For another suffix or space.
        OutputError
            When the file cannot be written.
        """
        writer, flip = writer_for(path, space, "surface", SURFACE_WRITERS)
        write_bytes(Path(path), writer(self.vertices * flip, self.faces, space.upper(), label))


def extract_surface(psi: NDArray[np.float32], geometry: Geometry) -> Surface:
    """The surface psi = 0 as a closed mesh.

    The vertices lie so that the mesh encloses the volume of the surface: that of a ball of radius 2 voxels is right
    within 1 %, of 5 voxels within 0.05 %, see `vertex_placement`; that of small parts down to a radius of 1.5 voxels of
    the coarsest axis within 2 %, see `small_parts`. Psi must be a signed distance within two voxels of the surface;
    further away its values do not matter, only their sign.

    Parameters
    ----------
    psi : ndarray, shape (nz, ny, nx)
        Level-set function in mm, negative inside.
    geometry : Geometry
        Its grid.

    Returns
    -------
    Surface
        Closed, normals outward, for left-handed directions too. The same psi gives the same bytes.

    Raises
    ------
    EmptyResultError
        When no voxel is inside. (All voxels inside is allowed: the box of the volume.)
    InputError
        When psi is not of the grid's shape, or not finite around the object.

    Examples
    --------
    >>> import numpy as np
    >>> psi = np.full((3, 4, 5), -1.0, dtype=np.float32)
    >>> box = extract_surface(psi, Geometry((3, 4, 5), (2.0, 1.0, 1.0)))
    >>> round(box.volume, 6), round(box.area, 6), box.is_closed
    (120.0, 148.0, True)
    """
    if psi.shape != geometry.shape:
        raise InputError(f"psi of shape {psi.shape} given, the grid's {geometry.shape} expected")
    zyx, faces = crossings(psi, geometry)
    zyx, faces = _merge_cap_edges(zyx, faces, geometry.shape)
    zyx = on_edges(zyx, psi, geometry.spacing, NODE_MARGIN * min(geometry.spacing))
    zyx = in_cells(zyx, faces, psi.shape)
    zyx = balanced(zyx, faces, psi, geometry.spacing)
    # skimage's triangles face outward in a right-handed (z, y, x); taken as (x, y, z) they are mirrored once, and
    # once more by a left-handed direction.
    if np.linalg.det(geometry.direction) > 0.0:
        faces = faces[:, ::-1]
    return Surface(geometry.index_to_world(zyx), np.ascontiguousarray(faces, dtype=np.int32))


def crossings(psi: NDArray[np.float32], geometry: Geometry) -> tuple[Floats, NDArray[np.int32]]:
    """Return the places (n, 3), as indices, where psi is 0 between two voxels, and the triangles between them.

    Raises
    ------
    EmptyResultError
        When no voxel is inside.
    """
    box = bounding_box(psi < 0)
    if box is None:
        raise EmptyResultError(
            "no voxel is inside: there is no surface", hint="the object vanished; start larger"
        )
    block, positions = _closed_block(psi, box, NODE_MARGIN * min(geometry.spacing))
    nodes, faces, _, _ = marching_cubes(block, level=0.0)
    zyx = np.stack(
        [np.interp(nodes[:, a], np.arange(len(positions[a])), positions[a]) for a in range(3)],
        axis=1,
    )
    return zyx, faces


def _closed_block(
    psi: NDArray[np.float32], inside: Box, margin: float
) -> tuple[NDArray[np.float32], list[Floats]]:
    """Psi around the box of the inside voxels, closed by caps, and the index position of its layers along each axis."""
    box = widened(inside, psi.shape, (1, 1, 1))
    block = psi[box].astype(np.float32, order="C")
    if not np.isfinite(block).all():
        raise InputError(
            "psi has NaN or infinite values around the object, finite distances expected"
        )
    near = np.abs(block) < margin
    block[near] = np.where(block[near] < 0, -margin, margin)
    positions = []
    for axis, (covered, n) in enumerate(zip(inside, psi.shape, strict=True)):
        position = np.arange(box[axis].start, box[axis].stop, dtype=np.float64)
        if covered.start == 0:
            block = np.concatenate([*_cap(block, axis, 0), block], axis=axis)
            position = np.concatenate([[-0.5, -0.5], position])
        if covered.stop == n:
            block = np.concatenate([block, *_cap(block, axis, -1)[::-1]], axis=axis)
            position = np.concatenate([position, [n - 0.5, n - 0.5]])
        positions.append(position)
    return block, positions


def _cap(
    block: NDArray[np.float32], axis: int, end: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two layers, outer first, that both lie on the outer face of the border voxels.

    The inner one continues psi, so that the surface reaches the face at a right angle. The outer one is all outside, so
    the surface passes between the two; as they lie at the same place, it is flat on the face.
    """
    inner = np.take(block, [end], axis=axis)
    return np.abs(inner), inner


def _merge_cap_edges(
    zyx: Floats, faces: Faces, shape: tuple[int, int, int]
) -> tuple[Floats, Faces]:
    """Close the rims where two caps meet: their vertices coincide there, and the triangles between have no area."""
    on_cap = (zyx == -0.5) | (zyx == np.array(shape) - 0.5)
    rim = np.flatnonzero(on_cap.sum(axis=1) >= 2)
    if not len(rim):
        return zyx, faces
    _, first, which = np.unique(zyx[rim], axis=0, return_index=True, return_inverse=True)
    target = np.arange(len(zyx))
    target[rim] = rim[first[which.ravel()]]
    merged = target[faces]
    a, b, c = merged.T
    used, numbers = np.unique(merged[(a != b) & (b != c) & (c != a)], return_inverse=True)
    return zyx[used], numbers.reshape(-1, 3).astype(np.int32)


def writer_for(
    path: str | Path, space: str, shape: Shape, writers: Mapping[str, Callable[..., bytes]]
) -> tuple[Callable[..., bytes], Floats]:
    """Choose a writer by a file's suffix, and the factors that bring LPS points to the space asked for.

    Parameters
    ----------
    path : str or Path
        The file to be written.
    space : {"lps", "ras"}
        Its coordinates.
    shape : {"surface", "contour"}
        Kind of the file's content.
    writers : mapping of str to callable
        The writers by the names of the formats.

    Raises
    ------
    UsageError
        For another suffix or space.
    """
    target = Path(path)
    kind = "mesh" if shape == "surface" else "contour"
    suffixes = {MESH_FORMATS[name].suffix: name for name in mesh_formats(shape)}
    name = suffixes.get(target.suffix.lower())
    if name is None:
        known = ", ".join(suffixes)
        raise UsageError(
            f"{target.name}: {kind} format {target.suffix!r} given, one of {known} expected"
        )
    if space not in SPACES:
        raise UsageError(f"{kind} space {space!r} given, one of {', '.join(SPACES)} expected")
    return writers[name], np.array([-1.0, -1.0, 1.0]) if space == "ras" else np.ones(3)
