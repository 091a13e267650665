"""An object that is followed: its momentum, its appearance when it was seen last, its mesh."""

from __future__ import annotations

import dataclasses
import math
import operator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from accelsurf.grid.geometry import Geometry
from accelsurf.measure import Surface, extract_surface
from accelsurf.run import cropped
from accelsurf.track.appearance import Appearance
from accelsurf.track.evidence import FACTOR, Profile, volume_in_grid
from accelsurf.track.frame_run import Measured
from accelsurf.track.image_motion import LIKE
from accelsurf.track.momentum import SurfaceMomentum, Triple
from accelsurf.track.records import SurfacePiece, TrackedMesh, TrackedObject

#: A new mesh is made where the volume of a moved one differs from that of its surface by more than this part, or
#: where more than this part of its triangles has turned over.
MAX_DIFFERENCE = 0.05
#: A part or a cavity of at most this number of voxels is below the grid's resolution: momentum may lose it.
UNRESOLVED = 14
VANISHED = "vanished"
LEFT = "left"
LOST = "lost"


class MeshCarrier:
    """The mesh of one object, which moves with the points that are attached to its momentum.

    A new mesh begins, and with it a new generation, where the topology changes, triangles turn over, or the moved
    mesh does not describe the surface any more.
    """

    def __init__(
        self, faces: ArrayLike = (), topology: tuple[int, ...] = (0, 0), generation: int = 0
    ) -> None:
        self._faces = np.array(faces, np.int64).reshape(-1, 3)
        self._topology, self._generation = tuple(topology), int(generation)

    def in_frame(self, momentum: SurfaceMomentum, geometry: Geometry) -> TrackedMesh | None:
        """The mesh now, in an image of more than one slice; None where nothing of the object lies in the grid."""
        piece = momentum.piece
        if geometry.slice_axis is not None or not piece.has_inside or (piece.psi < 0).all():
            return None
        topology = _topology_of(piece)
        points = momentum.points
        if (
            topology != self._topology
            or not len(points)
            or not self._describes(points, momentum.volume())
        ):
            made = extract_surface(piece.psi, cropped(geometry, piece.box))
            momentum.attach_points(made.vertices)
            self._faces, self._topology = made.faces.astype(np.int64), topology
            self._generation += 1
            points = momentum.points
        return TrackedMesh(points, self._faces, self._generation)

    def _describes(self, points: NDArray[np.float64], volume: float) -> bool:
        """Test if the moved points are still a mesh of the surface."""
        mesh = Surface(points, self._faces.astype(np.int32))
        return abs(mesh.volume - volume) <= MAX_DIFFERENCE * abs(volume)

    def state(self) -> dict[str, Any]:
        """State as a value: the arguments of a carrier that goes on; the points are of the momentum's."""
        return {"faces": self._faces, "topology": self._topology, "generation": self._generation}


def _topology_of(piece: SurfacePiece) -> tuple[int, int]:
    """Numbers of parts inside and outside: they change where an object divides, merges or encloses something."""
    inside = np.pad(piece.psi < 0, 1, mode="edge")
    outside = np.pad(piece.psi >= 0, 1, constant_values=True)
    return int(ndimage.label(inside)[1]), int(ndimage.label(outside)[1])


def _parts_of(piece: SurfacePiece, above: int = 0) -> tuple[int, int]:
    """Numbers of parts inside and outside of more than ``above`` voxels, of an object that no border cuts."""
    outside = np.pad(piece.psi.squeeze() >= 0, 1, constant_values=True)
    sizes = (np.bincount(ndimage.label(side)[0].ravel())[1:] for side in (~outside, outside))
    inner, outer = (int((size > above).sum()) for size in sizes)
    return inner, outer


class Whole(NamedTuple):
    """An object that no border of the grid cuts: the image across its surface, and its volume."""

    profile: Profile
    volume_mm3: float


class Trust(NamedTuple):
    """Description of an object whose surface was given.

    ``profile`` across it; its connected ``parts``; its ``depth``, mm: twice volume over area, the thickness of a wall
    or two thirds of the radius of a ball; ``is_run``, whether the energy of runs holds it in that frame; ``appearance``
    near it where it does not, None where there is nothing to learn.
    """

    profile: Profile
    parts: int
    depth: float
    is_run: bool
    appearance: Appearance | None


@dataclass
class Followed:
    """An object that is followed from frame to frame.

    Attributes
    ----------
    id : int
    momentum : SurfaceMomentum
    profile : Profile
        The image across its surface in the frame in which it was seen last.
    volume_mm3, area_mm2 : float
        Then, as far as the grid goes.
    centroid, velocity : (x, y, z)
        Then, world mm, and mm per unit of time.
    time : float
        Of that frame.
    at_border : bool
        Whether it lay on the border of the grid then.
    quality : float
        Of the surface in that frame.
    missing : int
        Number of frames since in which it was not seen.
    mesh : MeshCarrier or None
    trust : Trust or None
        Of an object whose surface was given.
    variance, drift : float
        Of the surface as it is known, and of a way by momentum alone, mm2; inf: nothing is known of it.
    likeness : float
        Correlation of its neighbourhood with the frame before; 0 where none was matched.
    whole_profile, whole_mm3
        ``profile`` and ``volume_mm3`` of the last frame in which no border of the grid cut it.
    last_seen : SurfacePiece
        Its surface in the frame in which it was seen last.
    """

    id: int
    momentum: SurfaceMomentum
    profile: Profile
    volume_mm3: float
    area_mm2: float
    centroid: Triple
    velocity: Triple
    time: float
    at_border: bool
    quality: float = 0.0
    missing: int = 0
    mesh: MeshCarrier | None = None
    trust: Trust | None = None
    variance: float = 0.0
    drift: float = math.inf
    likeness: float = 0.0
    whole_profile: Profile | None = None
    whole_mm3: float = 0.0
    last_seen: SurfacePiece | None = None

    def __post_init__(self) -> None:
        if self.last_seen is None:
            self.last_seen = self.momentum.piece
        if self.whole_profile is None:
            self.whole_profile, self.whole_mm3 = self.profile, self.volume_mm3

    @property
    def whole(self) -> Whole:
        """The object as it was when it last lay within the grid as a whole."""
        return Whole(self.whole_profile or self.profile, self.whole_mm3)

    def note_cut(self, whole: Whole) -> None:
        """Note that the border cuts the object, which is known as a ``whole`` from elsewhere."""
        self.whole_profile, self.whole_mm3 = whole.profile, max(whole.volume_mm3, self.volume_mm3)

    def note_given(self, trust: Trust | None) -> None:
        """Note the description of the object that its given surface shows."""
        self.trust = trust

    def note_motion(self, innovation: float, variance: float, likeness: float) -> None:
        """Note a motion that the image has shown: mean square off the momentum's, its variance, mm2, and likeness."""
        known = math.isfinite(self.drift)
        self.drift = 0.5 * (self.drift + innovation) if known else innovation
        self.variance, self.likeness = self.variance + variance, likeness

    def note_unmatched(self, likeness: float) -> None:
        """Note that the image does not show how the object moves: it goes on by its momentum."""
        self.variance, self.likeness = (
            self.variance + (self.drift if math.isfinite(self.drift) else 0.0),
            likeness,
        )

    @property
    def is_run(self) -> bool:
        """True if frames are run on by the energy: not if a run on the given frame has left the given surface."""
        return self.trust is None or self.trust.is_run

    @property
    def appearance(self) -> Appearance | None:
        """Appearance by which it is found instead, if it is."""
        return None if self.trust is None or self.trust.is_run else self.trust.appearance

    @property
    def goes_with_image(self) -> bool:
        """True if its surface was given, and the image has shown how it moved to this frame."""
        return self.trust is not None and self.likeness >= LIKE

    @property
    def is_lost(self) -> bool:
        """True if its place is less certain than the object is thick."""
        return self.trust is not None and not self.is_run and self.variance > self.trust.depth**2

    def prior(self, least: float) -> float:
        """Weight of the distance from the predicted surface, 1/mm, in a run by the appearance.

        The potential of the evidence near the given surface has the slope s and found the surface with the variance R:
        with s R/P the surface goes K = P/(P + R) of the way to where the evidence has it. P is at least ``least``, mm2.
        """
        assert self.appearance is not None
        return self.appearance.slope * self.appearance.variance / max(self.variance, least)

    @property
    def depth(self) -> float:
        """Depth of an object that no runs correct, mm, as `Trust` has it; 0 of others."""
        return 0.0 if self.trust is None or self.trust.is_run else self.trust.depth

    def inherit(self, parent: Followed) -> None:
        """Take over the description of the object that this was a part of."""
        if parent.trust is not None and not parent.trust.is_run:
            self.trust = parent.trust._replace(
                parts=1, depth=2.0 * self.volume_mm3 / max(self.area_mm2, 1e-300)
            )
            self.variance = parent.variance
            self.drift = parent.drift
            self.likeness = parent.likeness

    def chance(self, now: Profile) -> float:
        """Chance that a surface that only moves is good: the part left of the structure across it, and certainty."""
        assert self.trust is not None  # else it is run
        left = min(1.0, max(0.0, now.strength(self.trust.profile)))
        return left * math.exp(-self.variance / max(self.trust.depth, 1e-6) ** 2)

    def note_corrected(self) -> None:
        """Note that the surface lies where the frame has it, as far as that tells."""
        found = 0.0 if self.appearance is None else self.appearance.variance
        self.variance *= found / max(self.variance + found, 1e-300)

    def note_missing(self) -> None:
        """Note that a frame does not show the object."""
        self.missing += 1

    @property
    def is_in_grid(self) -> bool:
        """True if a part of the object lies within the grid."""
        return self.momentum.piece.has_inside

    @property
    def why_gone(self) -> str:
        """Why it is not seen any more."""
        if self.is_lost:
            return LOST
        return LEFT if self.at_border or not self.is_in_grid else VANISHED

    def predict(self, time: float, duration: float, geometry: Geometry) -> SurfacePiece:
        """Predict the surface at a ``time``, ``duration`` after the last prediction.

        Where the momentum has closed a cavity or lost a part that was seen last, or the volume is not near that seen
        last, the shape seen last goes on as a whole: no force on a surface opens a cavity again.
        """
        velocity = self.momentum.mean_velocity()
        piece = self.momentum.predict(duration)
        seen = self.last_seen
        if seen is None or not seen.has_inside or not piece.has_inside:
            return piece
        if self.at_border or lies_on_border(piece, geometry):
            return piece  # nothing is known beyond the border
        ratio = volume_in_grid(piece.psi, geometry) / max(self.volume_mm3, 1e-300)
        is_whole = all(map(operator.ge, _parts_of(piece), _parts_of(seen, UNRESOLVED)))
        if 1.0 / FACTOR <= ratio <= FACTOR and is_whole:
            return piece
        self.momentum.start(seen.psi, seen.corner, geometry, velocity)
        return self.momentum.predict(time - self.time)

    def predicted_place(self, time: float) -> Triple:
        """Predict the centroid, world mm."""
        x, y, z = (
            c + v * (time - self.time) for c, v in zip(self.centroid, self.velocity, strict=True)
        )
        return x, y, z

    def note_seen(self, found: Measured, profile: Profile, time: float, geometry: Geometry) -> None:
        """Keep the measures of the frame, after the momentum was corrected by it."""
        self.profile = profile
        self.volume_mm3 = found.volume_mm3
        self.area_mm2 = found.area_mm2
        self.centroid, self.velocity = self.momentum.centroid(), self.momentum.mean_velocity()
        self.time = time
        self.quality = found.quality
        self.missing = 0
        self.last_seen = self.momentum.piece
        self.at_border = lies_on_border(found.surface, geometry)
        if not self.at_border:
            self.whole_profile, self.whole_mm3 = profile, found.volume_mm3

    def in_frame(self, predicted: SurfacePiece | None, geometry: Geometry) -> TrackedObject:
        """Return the record of the object in a frame."""
        seen = self.missing == 0
        mesh = None
        if self.mesh is not None and seen:
            mesh = self.mesh.in_frame(self.momentum, geometry)
        return TrackedObject(
            self.id,
            self.momentum.piece,
            predicted,
            self.momentum.mean_velocity(),
            self.momentum.volume(),
            self.momentum.area(),
            self.momentum.centroid(),
            seen,
            self.quality if seen else 0.0,
            mesh,
        )

    def state(self) -> dict[str, Any]:
        """State as a value, for `restored`."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        mesh = None if self.mesh is None else self.mesh.state()
        looks = {"profile": self.profile.values, "whole_profile": self.whole.profile.values}
        return plain | looks | {"momentum": self.momentum.state(), "mesh": mesh}


def restored(state: dict[str, Any], momentum: SurfaceMomentum, geometry: Geometry) -> Followed:
    """An object as it was; ``momentum`` is one without a surface yet."""
    momentum.restore(state["momentum"], geometry)
    mesh = None if state["mesh"] is None else MeshCarrier(**state["mesh"])
    looks = {key: Profile(tuple(state[key])) for key in ("profile", "whole_profile")}
    return Followed(**(state | looks | {"momentum": momentum, "mesh": mesh}))


def lies_on_border(surface: SurfacePiece, geometry: Geometry) -> bool:
    """Test if a voxel inside lies on the border of the grid; axes with one slice do not count."""
    inside = surface.psi < 0
    for axis, n in enumerate(geometry.shape):
        if n == 1:
            continue
        first, last = -surface.corner[axis], n - 1 - surface.corner[axis]
        if any(
            0 <= end < inside.shape[axis] and inside.take(end, axis).any() for end in (first, last)
        ):
            return True
    return False
