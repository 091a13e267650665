"""Meshes made smoother or coarser for further use, with the largest distance to the surface as it was extracted.

Every operation keeps the mesh closed and facing outward; one that does not is undone, with a warning.
"""

from __future__ import annotations

import importlib
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from accelsurf.errors import InputError, UsageError
from accelsurf.measure.mesh_distance import largest_distance, mean_side, sides
from accelsurf.measure.surface_mesh import Surface

#: Rounds of smoothing, at most; more are needed where the length is more than about 12 sides of triangles.
MAX_ROUNDS = 2000
#: How eagerly the library collapses edges, its own default first.
EAGERNESS = (7, 6, 5, 8)
#: Tries of the search for the coarsest mesh within an error.
SEARCHES = 9


@dataclass(frozen=True)
class MeshOptions:
    """Requested options of a mesh.

    Attributes
    ----------
    smooth : float
        Bumps shorter than this are flattened, mm; 0 for none.
    faces : int or None
        Number of triangles.
    error : float or None
        Largest distance to the surface that is allowed, mm; without ``faces`` the mesh is made as coarse as it
        allows.
    """

    smooth: float = 0.0
    faces: int | None = None
    error: float | None = None


@dataclass(frozen=True, eq=False)
class ShapedMesh:
    """A mesh that was made smoother or coarser.

    Attributes
    ----------
    surface : Surface
    distance_mm : float
        Largest distance to the surface that was extracted, see `accelsurf.measure.mesh_distance.largest_distance`.
    warnings : tuple of str
    """

    surface: Surface
    distance_mm: float
    warnings: tuple[str, ...] = ()


def shape_mesh(exact: Surface, options: MeshOptions) -> ShapedMesh:
    """Make a mesh smoother or coarser.

    Parameters
    ----------
    exact : Surface
        As it was extracted. It is not changed.
    options : MeshOptions

    Raises
    ------
    UsageError
        When the request cannot be met within the error, or the smoothing is too long for the mesh; InputError when
        a package lacks.

    Examples
    --------
    >>> from accelsurf.grid.geometry import Geometry
    >>> from accelsurf.measure.surface_mesh import extract_surface
    >>> z, y, x = np.indices((16, 16, 16)) - 7.5
    >>> psi = (np.sqrt(x**2 + y**2 + z**2) - 5).astype(np.float32)
    >>> ball = extract_surface(psi, Geometry((16, 16, 16), (1.0, 1.0, 1.0)))
    >>> coarse = shape_mesh(ball, MeshOptions(faces=200))
    >>> len(coarse.surface.faces), coarse.surface.is_closed, coarse.distance_mm < 0.3
    (200, True, True)
    """
    surface, warnings = exact, list[str]()
    if options.smooth:
        surface = _sound_or_old(smoothed(surface, options.smooth), surface, "mesh-smooth", warnings)
    if options.error is not None:
        _refuse_beyond(exact, surface, options.error, "mesh-smooth", f"{options.smooth:g} mm")
    if options.faces is not None and options.faces < len(surface.faces):
        surface = _sound_or_old(decimated(surface, options.faces), surface, "mesh-faces", warnings)
    elif options.faces is not None and options.faces > len(surface.faces):
        warnings.append(
            f"mesh-faces: the mesh has {len(surface.faces)} triangles, fewer than {options.faces}"
        )
    elif options.error is not None and options.faces is None:
        surface = coarsest(exact, surface, options.error)
    if options.error is not None and options.faces is not None:
        _refuse_beyond(
            exact, surface, options.error, "mesh-faces", f"{len(surface.faces)} triangles"
        )
    distance = 0.0 if surface is exact else largest_distance(exact, surface)
    return ShapedMesh(surface, distance, tuple(warnings))


def _refuse_beyond(exact: Surface, surface: Surface, error: float, key: str, how: str) -> None:
    """Refuse a mesh that is further from the surface than is allowed."""
    if surface is exact:
        return
    found = largest_distance(exact, surface)
    if found > error:
        raise UsageError(
            f"mesh_error: {error:g} mm was given, and {how} of {key} lead to {found:.3g} mm",
            f"--mesh-error {_above(found)}, or another --{key}",
        )


def _above(value: float) -> str:
    """A number of two digits that is not below a value."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit) * unit:.2g}"


def is_sound(surface: Surface) -> bool:
    """Test if each side of a triangle has exactly one other beside it that faces the same way, and volume is inside.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
    >>> inside_out = faces[:, ::-1]
    >>> [is_sound(Surface(corners, some)) for some in (faces, faces[:3], inside_out)]
    [True, False, False]
    """
    if len(surface.faces) < 4 or not surface.is_closed or surface.volume <= 0:
        return False
    start, end = (
        surface.faces.astype(np.int64).ravel(),
        np.roll(surface.faces, -1, axis=1).astype(np.int64).ravel(),
    )
    return len(np.unique(start * len(surface.vertices) + end)) == len(start)


def _sound_or_old(new: Surface, old: Surface, key: str, warnings: list[str]) -> Surface:
    """The new mesh if it is sound, else the old one, with a warning."""
    if is_sound(new) or (new.is_closed and new.volume > 0 and not is_sound(old)):
        return new
    warnings.append(f"{key}: left out, as the mesh would not be closed")
    return old


def smoothed(surface: Surface, length: float) -> Surface:
    """Flatten bumps: half remains of bumps of this wavelength, less of shorter ones; the volume stays.

    Taubin's two steps, along and against the umbrella vector of each vertex: p + l L p, then p + m L p. A wave of
    length w on triangles with sides h has the eigenvalue k = (pi h / w)^2, and is multiplied by (1 - l k)(1 - m k) in
    each round. Waves of more than 1.4 times the length pass. Then all vertices move by the same small way along their
    normals, so that the volume is as it was.

    Parameters
    ----------
    surface : Surface
    length : float
        mm.

    Raises
    ------
    UsageError
        When the length is too large for the mesh.
    """
    k = min((math.pi * mean_side(surface) / length) ** 2, 1.0)
    forward = 0.5
    backward = 1.0 / (k / 2 - 1.0 / forward)
    rounds = max(1, math.ceil(math.log(0.5) / math.log((1 - forward * k) * (1 - backward * k))))
    if rounds > MAX_ROUNDS:
        raise UsageError(
            f"mesh_smooth: {length:g} mm was given, much longer than the mesh's sides of {mean_side(surface):.2g} mm",
            "smooth less; the setting smoothness makes the surface itself smoother",
        )
    edges, n = sides(surface), len(surface.vertices)
    ones = np.ones(2 * len(edges))
    beside = sparse.csr_matrix((ones, (edges.ravel("F"), edges[:, ::-1].ravel("F"))), shape=(n, n))
    weights = 1.0 / np.maximum(np.asarray(beside.sum(axis=1)), 1.0)
    points = surface.vertices - surface.vertices.mean(axis=0)
    for _ in range(rounds):
        for factor in (forward, backward):
            points = points + factor * (weights * (beside @ points) - points)
    return _with_volume(
        Surface(points + surface.vertices.mean(axis=0), surface.faces), surface.volume
    )


def _with_volume(surface: Surface, volume: float) -> Surface:
    """The mesh with its vertices moved along their normals, all by the same way, so that it has a volume."""
    for _ in range(3):  # Newton's method: the derivative of the volume is the area
        corners = surface.vertices[surface.faces]
        normals = np.zeros_like(surface.vertices)
        area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for k in range(3):
            np.add.at(normals, surface.faces[:, k], area_vectors)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        way = (volume - surface.volume) / surface.area
        surface = Surface(surface.vertices + way * normals, surface.faces)
    return surface


def decimated(surface: Surface, faces: int) -> Surface:
    """About this number of triangles, by the collapse of edges that moves the surface least (quadric errors).

    The library may let a collapse join two sheets in an edge: then other ways and numbers nearby are tried.
    """
    middle = surface.vertices.mean(axis=0)
    simplify, first = mesh_library("fast_simplification").simplify, None
    for count, eagerness in itertools.product(
        (faces, faces + 2, faces - 2, faces + 6, faces - 6), EAGERNESS
    ):
        options = {"target_count": max(count, 4), "agg": eagerness}
        points, triangles = simplify(surface.vertices - middle, surface.faces, **options)
        coarse = Surface(
            np.asarray(points, np.float64) + middle, np.ascontiguousarray(triangles, np.int32)
        )
        if is_sound(coarse) and len(coarse.faces) <= faces + 6:
            return coarse
        first = coarse if first is None else first
    assert first is not None
    return first


def coarsest(exact: Surface, surface: Surface, error: float) -> Surface:
    """The mesh with the fewest triangles of those tried whose distance to the exact surface is at most the error."""
    low = math.log(4.0)
    high = math.log(len(surface.faces))
    best = surface
    for _ in range(SEARCHES):
        middle = (low + high) / 2
        candidate = decimated(surface, round(math.exp(middle)))
        if is_sound(candidate) and largest_distance(exact, candidate, error) <= error:
            high, best = math.log(min(len(candidate.faces), math.exp(middle))), candidate
        else:
            low = middle
    return best


def mesh_library(name: str) -> Any:
    """Return a package.

    Raises
    ------
    InputError
        When it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.replace("_", "-")
        raise InputError(
            f"coarser meshes need the package {package}",
            'install it: pip install "accelsurf[mesh]"',
        ) from None
