"""An object that is followed: its momentum, what it looked like when it was seen last, its mesh."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from accelsurf.grid.geometry import Geometry
from accelsurf.tracking.carried_mesh import MeshCarrier
from accelsurf.tracking.evidence import Profile
from accelsurf.tracking.frame_run import Measured
from accelsurf.tracking.momentum import SurfaceMomentum, Triple
from accelsurf.tracking.records import SurfacePiece, TrackedObject

VANISHED, LEFT = "vanished", "left"


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
    whole_profile, whole_mm3
        ``profile`` and ``volume_mm3`` of the last frame in which no border of the grid cut it.
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
    whole_profile: Profile | None = None
    whole_mm3: float = 0.0

    def __post_init__(self) -> None:
        if self.whole_profile is None:
            self.whole_profile, self.whole_mm3 = self.profile, self.volume_mm3

    @property
    def like(self) -> Profile:
        """What it looks like when it lies within the grid as a whole."""
        return self.whole_profile or self.profile

    @property
    def is_in_grid(self) -> bool:
        """Whether something of it lies within the grid."""
        return self.momentum.piece.has_inside

    @property
    def why_gone(self) -> str:
        """Why it is not seen any more."""
        return LEFT if self.at_border or not self.is_in_grid else VANISHED

    def predicted_place(self, time: float) -> Triple:
        """Where its centroid would be, world mm."""
        x, y, z = (c + v * (time - self.time) for c, v in zip(self.centroid, self.velocity, strict=True))
        return x, y, z

    def note_seen(self, found: Measured, profile: Profile, time: float, geometry: Geometry) -> None:
        """Note what the frame showed, after the momentum was corrected by it."""
        self.profile, self.volume_mm3, self.area_mm2 = profile, found.volume_mm3, found.area_mm2
        self.centroid, self.velocity = self.momentum.centroid(), self.momentum.mean_velocity()
        self.time, self.quality, self.missing = time, found.quality, 0
        self.at_border = lies_on_border(found.surface, geometry)
        if not self.at_border:
            self.whole_profile, self.whole_mm3 = profile, found.volume_mm3

    def in_frame(self, predicted: SurfacePiece | None, geometry: Geometry) -> TrackedObject:
        """What is told of it in a frame."""
        seen = self.missing == 0
        mesh = None
        if self.mesh is not None and seen:
            mesh = self.mesh.in_frame(self.momentum, geometry)
        return TrackedObject(
            self.id, self.momentum.piece, predicted, self.momentum.mean_velocity(), self.momentum.volume(),
            self.momentum.area(), self.momentum.centroid(), seen, self.quality if seen else 0.0, mesh,
        )

    def state(self) -> dict[str, Any]:
        """State as a value, for `restored`."""
        plain = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        mesh = None if self.mesh is None else self.mesh.state()
        looks = {"profile": self.profile.values, "whole_profile": self.like.values}
        return plain | looks | {"momentum": self.momentum.state(), "mesh": mesh}


def restored(state: dict[str, Any], momentum: SurfaceMomentum, geometry: Geometry) -> Followed:
    """An object as it was; ``momentum`` is one without a surface yet."""
    momentum.restore(state["momentum"], geometry)
    mesh = None if state["mesh"] is None else MeshCarrier.restored(state["mesh"])
    looks = {key: Profile(tuple(state[key])) for key in ("profile", "whole_profile")}
    return Followed(**(state | looks | {"momentum": momentum, "mesh": mesh}))


def lies_on_border(surface: SurfacePiece, geometry: Geometry) -> bool:
    """Whether a voxel inside lies on the border of the grid; axes with one slice do not count."""
    inside = surface.psi < 0
    for axis, n in enumerate(geometry.shape):
        if n == 1:
            continue
        first, last = -surface.corner[axis], n - 1 - surface.corner[axis]
        if any(0 <= end < inside.shape[axis] and inside.take(end, axis).any() for end in (first, last)):
            return True
    return False
