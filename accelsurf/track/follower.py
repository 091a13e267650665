"""From one frame to the next: prediction, measurement, correction, identities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf.grid.boxes import corner_of, widened
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.image.volume import Volume
from accelsurf.levelset import Workers
from accelsurf.run import EnergyLike
from accelsurf.settings.corrections import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.starts import ObjectStart
from accelsurf.track import evidence
from accelsurf.track.appearance import appearance_of
from accelsurf.track.boxed_surface import groups_of, on_larger_box, separate_parts, touching
from accelsurf.track.evidence import FACTOR, Profile, profile, volume_in_grid
from accelsurf.track.followed import Followed, MeshCarrier, Trust, Whole, lies_on_border, restored
from accelsurf.track.frame_run import (
    NOTHING,
    Measured,
    following_settings,
    measure,
    measured_piece,
    recognised,
)
from accelsurf.track.image_motion import LIKE, image_motion
from accelsurf.track.momentum import Gains, SurfaceMomentum, Triple
from accelsurf.track.momentum_models import FlowableMomentum, make_momentum
from accelsurf.track.records import BAND, Identities, SurfacePiece, TrackedObject

#: Voxels within this distance, voxels, of a tracked object are part of no other object.
APART = 2
#: A run on a frame counts if that on the given frame, from the given surface, leaves it by a mean square of no more
#: than this, in voxels, in the first and in the second number of steps: half a voxel is the rounding of labels.
ROUNDING = 0.3
TRIED_STEPS = (5, 40)
#: Least variance, voxels squared, of a predicted surface, and of a surface that an appearance finds.
MIN_PRIOR_DEVIATION = 0.05
MIN_VARIANCE = 0.25
#: Tracks of objects that no runs correct are not trusted in a frame in which their mean quality is lower.
TRUSTED = 0.6
#: An object that no runs correct goes on with voxels twice as large from this depth on, voxels.
HALVED_DEPTH = 4.0
#: Least number of voxels of an object that the border of the grid cuts.
MIN_CUT = 8


@dataclass(frozen=True)
class Arrival:
    """A frame that comes next.

    Attributes
    ----------
    number, before : int
        The frame, and the one that was done before it.
    time, duration : float
        Of the frame, and since the one before; below 0 in falling order.
    channels : list of Volume
    refinements : tuple of Correction
        Corrections of the frame.
    """

    number: int
    before: int
    time: float
    duration: float
    channels: list[Volume]
    refinements: tuple[Correction, ...] = ()


class Follower:
    """All objects of a tracking in one order of the frames.

    Parameters
    ----------
    config : TrackConfig
    sequence : ImageSequence
        Its grid and times count here.
    identities : Identities
    workers : Workers
    energy : Energy or callable, optional
        One of the user's own.
    meshes : bool
        Whether meshes move with the momentum.
    """

    def __init__(
        self,
        config: TrackConfig,
        sequence: ImageSequence,
        identities: Identities,
        workers: Workers,
        energy: EnergyLike | None = None,
        meshes: bool = False,
    ) -> None:
        self._config = config
        self._geometry = sequence.geometry
        self._identities = identities
        self._workers = workers
        self._sequence = sequence
        self._friction = config.friction_for(sequence.times)
        self._energy, self._meshes = energy, meshes
        self._run: RunConfig = following_settings(config.run, config.next_energy)
        self._gains = Gains(*config.gains)
        self.objects: list[Followed] = []

    # -- the first frame -----------------------------------------------------------------------------------

    def start(
        self,
        objects: Sequence[tuple[int, Measured]],
        arrival: Arrival,
        velocity: dict[int, Triple],
        trust: dict[int, Trust],
    ) -> None:
        """Begin with the objects of a frame; ``velocity`` and ``trust`` of each where they are known."""
        for id, measured in objects:
            followed = self._add(id, measured, arrival, velocity.get(id))
            followed.note_given(trust.get(id))

    def learn_trust(self, arrival: Arrival) -> dict[int, Trust]:
        """Learn from a frame whose surfaces are given, and lie in it now, how far a run on a frame can be trusted."""
        given = {
            followed.id: followed.momentum.piece for followed in self.objects if followed.is_in_grid
        }
        starts = [ObjectStart(id, *piece) for id, piece in given.items()]
        step = min(self._geometry.steps)
        trust = {}
        moving_ids = set(given)
        for steps in TRIED_STEPS:
            if moving_ids:
                run = self._run.replace(max_steps=min(steps, self._run.max_steps))
                found = measure(arrival.channels, starts, run, self._energy)
                left = {
                    id: mean_square(piece, found[id].surface, step) for id, piece in given.items()
                }
                moving_ids &= {id for id, square in left.items() if square <= ROUNDING * step**2}
        for followed in [followed for followed in self.objects if followed.id in given]:
            piece, holds = given[followed.id], followed.id in moving_ids
            depth = 2.0 * followed.volume_mm3 / max(followed.area_mm2, 1e-300)
            appearance = None if holds else appearance_of(arrival.channels[0], piece)
            if appearance is not None:
                again = recognised(
                    self._at_rest(piece, depth).moved_surface(0.0),
                    appearance,
                    arrival.channels[0],
                    0.0,
                )
                off = mean_square(piece, again.surface, step)
                lost = not math.isfinite(off)
                appearance = (
                    None if lost else appearance._replace(variance=max(off, MIN_VARIANCE * step**2))
                )
            parts = max(1, len(separate_parts(piece)))
            trust[followed.id] = Trust(followed.profile, parts, depth, holds, appearance)
            followed.note_given(trust[followed.id])
        return trust

    def _at_rest(self, piece: SurfacePiece, depth: float) -> SurfaceMomentum:
        """A momentum of a surface at rest, on the grid on which one of that depth (mm) moves with the image."""
        momentum = self._new_momentum()
        momentum.start(piece.psi, piece.corner, self._geometry)
        self._choose_grid(momentum, depth)
        return momentum

    def _choose_grid(self, momentum: SurfaceMomentum, depth: float) -> None:
        """Let a surface of an object that no run corrects, of this depth (mm), go on with larger voxels."""
        if depth >= HALVED_DEPTH * max(self._geometry.steps):
            momentum.halve()

    def _add(self, id: int, found: Measured, arrival: Arrival, velocity: Triple | None) -> Followed:
        """Begin to follow an object."""
        momentum = self._new_momentum()
        momentum.start(found.surface.psi, found.surface.corner, self._geometry, velocity)
        return self._put(id, momentum, found, arrival)

    def _put(
        self, id: int, momentum: SurfaceMomentum, found: Measured, arrival: Arrival
    ) -> Followed:
        seen = profile(arrival.channels[0], found.surface)
        followed = Followed(
            id,
            momentum,
            seen,
            found.volume_mm3,
            found.area_mm2,
            momentum.centroid(),
            momentum.mean_velocity(),
            arrival.time,
            lies_on_border(found.surface, self._geometry),
            found.quality,
            0,
            MeshCarrier() if self._meshes else None,
        )
        self.objects.append(followed)
        self._identities.see(id, arrival.number)
        return followed

    def _new_momentum(self) -> SurfaceMomentum:
        return make_momentum(self._config.model, self._friction, self._workers)

    # -- the next frame ------------------------------------------------------------------------------------

    def advance(self, arrival: Arrival) -> tuple[TrackedObject, ...]:
        """Follow all objects to the next frame.

        Returns
        -------
        tuple of TrackedObject
            In order of their ids.
        """
        for followed in self.objects:
            self._choose_grid(followed.momentum, followed.depth)
        self._steer(arrival)
        predicted = {
            followed.id: followed.predict(arrival.time, arrival.duration, self._geometry)
            for followed in self.objects
        }
        found = self._measure(predicted, arrival)
        self._decide(found, predicted, arrival)
        self._begin_clicked(found, arrival)
        self._divide(found, arrival)
        if self._config.merge == "yes":
            self._merge(arrival)
        self._look_for_more(arrival)
        for followed in [f for f in self.objects if f.missing > self._config.max_gap or f.is_lost]:
            self._end(followed, arrival)
        self.objects.sort(key=lambda followed: followed.id)
        return self.in_frame(predicted)

    def _steer(self, arrival: Arrival) -> None:
        """Let the image tell how the objects that the frame before shows move to this one."""
        before: Volume | None = None
        for followed in self.objects:
            momentum = followed.momentum
            if not isinstance(momentum, FlowableMomentum):
                continue
            if followed.missing or not followed.is_in_grid:
                followed.note_unmatched(0.0)
                continue
            before = before or self._sequence.channels(arrival.before)[0]
            expected = momentum.way(arrival.duration)
            seen = image_motion(before, arrival.channels[0], momentum.piece, expected)
            if seen is None or seen.likeness < LIKE:
                followed.note_unmatched(0.0 if seen is None else seen.likeness)
                continue
            steered = momentum.steer(seen, arrival.duration, followed.drift)
            followed.note_motion(steered.innovation, steered.variance, seen.likeness)

    @property
    def is_doubtful(self) -> bool:
        """True if the tracks cannot be trusted in the frame: the objects that no runs correct are mostly not found."""
        found = [
            0.0 if followed.missing else followed.quality
            for followed in self.objects
            if not followed.is_run
        ]
        return bool(found) and sum(found) < TRUSTED * len(found)

    def in_frame(self, predicted: dict[int, SurfacePiece]) -> tuple[TrackedObject, ...]:
        """Return the records of the objects in the frame."""
        return tuple(
            followed.in_frame(predicted.get(followed.id), self._geometry)
            for followed in self.objects
        )

    def _measure(self, predicted: dict[int, SurfacePiece], arrival: Arrival) -> dict[int, Measured]:
        """Segment the frame: the objects that were seen last, then the others in the voxels that these leave free."""
        first: list[ObjectStart] = []
        then: list[ObjectStart] = []
        unrun: list[int] = []
        for followed in self.objects:
            if not predicted[followed.id].has_inside:
                continue
            if not followed.is_run and not arrival.refinements:
                unrun.append(followed.id)
                continue
            start = ObjectStart(followed.id, *predicted[followed.id])
            (first if followed.missing == 0 else then).append(start)
        if arrival.refinements:
            first, then = [*first, *then], []
        run, energy = self._run, self._energy
        taken = [predicted[id] for id in unrun]
        found = (
            measure(arrival.channels, first, run, energy, arrival.refinements, taken)
            if first or not unrun
            else {}
        )
        for followed in [followed for followed in self.objects if followed.id in unrun]:
            if followed.appearance is None:
                found[followed.id] = measured_piece(predicted[followed.id], self._geometry)
                continue
            prior = followed.prior(MIN_PRIOR_DEVIATION * min(self._geometry.steps) ** 2)
            moved = followed.momentum.moved_surface(arrival.duration)
            found[followed.id] = recognised(moved, followed.appearance, arrival.channels[0], prior)
        if then:
            occupied = [
                measured.surface for measured in found.values() if measured.surface.psi.size
            ]
            found |= measure(arrival.channels, then, run, energy, occupied=occupied)
        return found

    def _decide(
        self, found: dict[int, Measured], predicted: dict[int, SurfacePiece], arrival: Arrival
    ) -> None:
        """Correct the objects that are seen; of the others the prediction stands."""
        clicked = {followed.object for followed in arrival.refinements if followed.kind == "clicks"}
        image, duration = arrival.channels[0], arrival.duration
        for followed in self.objects:
            is_of_this_object = bool(clicked & {None, followed.id})
            others = [other.surface for id, other in found.items() if id != followed.id]
            # Where the surface that a run finds is not the object, the one that goes with the image still may be.
            corrects = is_of_this_object or followed.is_run or followed.appearance is not None
            moves = corrects and followed.goes_with_image and predicted[followed.id].has_inside
            for is_run in (True, False) if moves else (corrects,):
                shown = found.get(followed.id, NOTHING)
                if moves and not is_run:
                    shown = measured_piece(predicted[followed.id], self._geometry)
                if not shown.surface.psi.size:
                    continue
                now = profile(image, shown.surface, others)
                if not is_of_this_object and not self._is_shown(
                    followed, shown, now, predicted[followed.id], not is_run
                ):
                    continue
                if is_run:
                    followed.momentum.correct(self._largest(shown).surface, duration, self._gains)
                    followed.note_corrected()
                if not is_of_this_object and not followed.is_run:
                    shown = shown._replace(quality=followed.chance(now))
                followed.note_seen(shown, now, arrival.time, self._geometry)
                self._identities.see(followed.id, arrival.number)
                break
            else:
                followed.note_missing()

    def _is_shown(
        self,
        followed: Followed,
        measured: Measured,
        now: Profile,
        predicted: SurfacePiece,
        moved: bool,
    ) -> bool:
        """Test if a surface is the object: one that a run has found, or that has ``moved`` with the image."""
        expected, seen = (
            volume_in_grid(piece.psi, self._geometry) for piece in (predicted, measured.surface)
        )
        if (
            followed.at_border
        ):  # the prediction knows only the part within the border; more of it may come in
            expected = max(expected, min(seen, followed.whole_mm3))
        ratio = expected / followed.volume_mm3 if followed.volume_mm3 > 0 else 1.0
        volumes = seen, expected
        areas = measured.area_mm2, followed.area_mm2 * ratio ** (2.0 / 3.0)
        return evidence.is_shown(
            now, followed.profile, volumes, areas, moved and followed.goes_with_image
        )

    def _largest(self, measured: Measured) -> Measured:
        """Remove crumbs from a surface where parts are objects; the parts of a division stay together here."""
        if self._config.divide == "no":
            return measured
        large = separate_parts(measured.surface)
        return measured if len(large) != 1 else measured._replace(surface=large[0])

    # -- identities ----------------------------------------------------------------------------------------

    def _begin_clicked(self, found: dict[int, Measured], arrival: Arrival) -> None:
        """Begin the objects that corrections of the frame have made, and end those that they have removed."""
        if not arrival.refinements:
            return
        ids = {followed.id for followed in self.objects}
        for id in sorted(found.keys() - ids):
            if found[id].surface.psi.size:
                self._add(id, found[id], arrival, None)
        for followed in [
            followed
            for followed in self.objects
            if followed.id not in found and followed.is_in_grid
        ]:
            self.objects.remove(followed)

    def _divide(self, found: dict[int, Measured], arrival: Arrival) -> None:
        """Let the parts of an object that has come apart be objects of their own."""
        if self._config.divide == "no":
            return
        for followed in [
            followed for followed in self.objects if followed.missing == 0 and followed.id in found
        ]:
            pieces = separate_parts(found[followed.id].surface)
            if len(pieces) <= (followed.trust.parts if followed.trust else 1):
                continue
            self.objects.remove(followed)
            self._identities.forget(followed.id, arrival.number)
            ids = []
            for momentum, piece in zip(followed.momentum.split(pieces), pieces, strict=True):
                ids.append(self._identities.new_id())
                part = measured_part(piece, momentum, followed.quality)
                self._put(ids[-1], momentum, part, arrival).inherit(followed)
            self._identities.divide(followed.id, ids, arrival.number, arrival.before)

    def _merge(self, arrival: Arrival) -> None:
        """Let objects that have become one be one."""
        seen = [followed for followed in self.objects if followed.missing == 0]
        if len(seen) < 2:
            return
        like = evidence.median_profile([followed.whole.profile for followed in seen])
        edge = 0.5 * (like.inner + like.outer)
        pairs = touching([followed.momentum.piece for followed in seen], arrival.channels[0], edge)
        for group in groups_of(pairs):
            old = [seen[place] for place in group]
            momentum = old[0].momentum.merged([followed.momentum for followed in old[1:]])
            for followed in old:
                self.objects.remove(followed)
                self._identities.forget(followed.id, arrival.number)
            id = self._identities.new_id()
            quality = min(followed.quality for followed in old)
            self._put(id, momentum, measured_part(momentum.piece, momentum, quality), arrival)
            self._identities.merge(
                [followed.id for followed in old], id, arrival.number, arrival.before
            )

    def _look_for_more(self, arrival: Arrival) -> None:
        """Find objects that come back, and new ones that enter where asked for."""
        # Where runs are not believed nothing that a run finds is the object come back.
        absent = [followed for followed in self.objects if followed.missing > 0 and followed.is_run]
        if not absent and self._config.enter == "no":
            return
        known = [followed for followed in self.objects if followed.missing == 0] or absent
        if not known:
            return
        like = evidence.median_profile([followed.whole.profile for followed in known])
        volumes = [followed.whole_mm3 for followed in self.objects]
        there = [followed.momentum.piece for followed in self.objects if followed.missing == 0]
        first = appearing(arrival.channels[0], there, like, (min(volumes), max(volumes)))
        if not first:
            return
        starts = [ObjectStart(place, *piece) for place, piece in enumerate(first, start=1)]
        found = measure(arrival.channels, starts, self._run, self._energy, occupied=there)
        usual = float(np.median([followed.whole_mm3 for followed in known]))
        for place in sorted(found):
            self._take_in(found[place], Whole(like, usual), absent, arrival)

    def _take_in(
        self, found: Measured, whole: Whole, absent: list[Followed], arrival: Arrival
    ) -> None:
        """Link a part that has appeared to an object that was missing, or let it enter; ``whole`` is a usual object."""
        if not found.surface.psi.size:
            return
        found = self._largest(found)
        momentum = self._new_momentum()
        momentum.start(found.surface.psi, found.surface.corner, self._geometry)
        if profile(arrival.channels[0], found.surface).strength(whole.profile) * FACTOR < 1.0:
            return
        place, size = np.array(momentum.centroid()), momentum.volume()
        cut = lies_on_border(found.surface, self._geometry)
        nearest, old = np.inf, None
        for followed in absent:
            places = followed.centroid, followed.predicted_place(arrival.time)
            away = min(float(np.linalg.norm(place - np.array(there))) for there in places)
            fits = size <= FACTOR * followed.whole_mm3 and (
                cut or followed.whole_mm3 <= FACTOR * size
            )
            if fits and away < nearest and away <= self._search_range(followed, arrival.time):
                nearest, old = away, followed
        if old is not None:
            absent.remove(old)
            self.objects.remove(old)
            way = (place - np.array(old.centroid)) / (arrival.time - old.time)
            followed = self._add(
                old.id, found, arrival, (float(way[0]), float(way[1]), float(way[2]))
            )
            followed.note_given(old.trust)
            whole = old.whole
        elif self._config.enter == "yes":
            followed = self._put(self._identities.new_id(), momentum, found, arrival)
        else:
            return
        if cut:
            followed.note_cut(whole)

    def _search_range(self, followed: Followed, time: float) -> float:
        """Range (mm) in which an object may come back: its diameter, and as far as it would have moved."""
        geometry = self._geometry
        if geometry.slice_axis is None:
            diameter = 2.0 * (3.0 * followed.whole_mm3 / (4.0 * np.pi)) ** (1.0 / 3.0)
        else:
            diameter = (
                2.0 * (followed.whole_mm3 / geometry.spacing[geometry.slice_axis] / np.pi) ** 0.5
            )
        return float(diameter + np.linalg.norm(followed.velocity) * abs(time - followed.time))

    def _end(self, followed: Followed, arrival: Arrival) -> None:
        """End an object that was not seen for too long."""
        self.objects.remove(followed)
        if arrival.before < arrival.number:
            self._identities.end(followed.id, followed.why_gone)

    def note_missing(self) -> None:
        """Note why objects are not seen in the last frame of a rising order."""
        for followed in self.objects:
            if followed.missing:
                self._identities.end(followed.id, followed.why_gone)

    # -- checkpoints ---------------------------------------------------------------------------------------

    def state(self) -> list[dict[str, Any]]:
        """State as a value, for `restore`."""
        return [followed.state() for followed in self.objects]

    def restore(self, state: Sequence[dict[str, Any]]) -> None:
        """Go back to a `state`."""
        self.objects = [restored(saved, self._new_momentum(), self._geometry) for saved in state]


def mean_square(given: SurfacePiece, found: SurfacePiece, step: float) -> float:
    """Mean square distance (mm2) of a surface that was found from a given one; inf where nothing was found.

    Where the given surface lies within a voxel, ``step`` (mm), it is the difference of the two distances; 0 where there
    is none.
    """
    if not found.has_inside:
        return math.inf
    first, near = np.array(given.corner), np.abs(given.psi) < step
    there = on_larger_box(found.psi, np.array(found.corner), first, first + given.psi.shape)
    return float(((there - given.psi)[near] ** 2).sum()) / max(1, int(near.sum()))


def measured_part(piece: SurfacePiece, momentum: SurfaceMomentum, quality: float) -> Measured:
    """Measure a part of a surface."""
    return Measured(piece, momentum.volume(), momentum.area(), quality)


def appearing(
    image: Volume, surfaces: Sequence[SurfacePiece], like: Profile, volumes: tuple[float, float]
) -> list[SurfacePiece]:
    """First surfaces of objects that appear in a frame, the largest first.

    They are parts whose values are nearer to the ones inside ``like`` than to the ones outside, after a Gaussian of one
    voxel, that do not come near any of the ``surfaces``, and are about as large as these or cut by the grid's border.

    Parameters
    ----------
    image : Volume
        The frame.
    surfaces : sequence of SurfacePiece
        Objects that are there.
    like : Profile
        Values across the surface of a tracked object.
    volumes : (float, float)
        Of the smallest and the largest tracked object, mm3: new objects lie within a factor of two of them. One that
        the border cuts may be smaller, down to `MIN_CUT` voxels: it has only begun to come in.
    """
    inner = like.inner
    outer = like.outer
    geometry = image.geometry
    if not (np.isfinite(inner) and np.isfinite(outer)) or inner == outer:
        return []
    smooth = gaussian_mm(image.as_float32(), geometry.spacing, min(geometry.steps))
    edge = 0.5 * (inner + outer)
    inside = smooth > edge if inner > outer else smooth < edge
    taken = np.zeros(geometry.shape, np.bool_)
    for surface in surfaces:
        taken[surface.box] |= surface.psi < 0
    if taken.any():
        taken = ndimage.binary_dilation(taken, iterations=APART)
    labels, count = ndimage.label(inside | taken)
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * geometry.voxel_volume
    low, high = volumes[0] / FACTOR, volumes[1] * FACTOR
    cut_low = min(MIN_CUT * geometry.voxel_volume, low)
    near = set(np.unique(labels[taken]).tolist()) | {0}
    found = [
        number
        for number in np.argsort(-sizes, kind="stable").tolist()
        if number not in near and cut_low <= sizes[number] <= high
    ]
    half, boxes = (
        np.float32(0.5 * min(geometry.steps)),
        ndimage.find_objects(labels) if found else [],
    )
    out = []
    for number in found:
        box = widened(boxes[number - 1], labels.shape, (BAND, BAND, BAND))
        piece = SurfacePiece(corner_of(box), np.where(labels[box] == number, -half, half))
        if sizes[number] >= low or lies_on_border(piece, geometry):
            out.append(piece)
    return out
