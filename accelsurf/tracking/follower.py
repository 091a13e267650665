"""From one frame to the next: prediction, what the frame shows, correction, identities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from accelsurf.grid.sequence import ImageSequence
from accelsurf.grid.volume import Volume
from accelsurf.initialization.object_starts import ObjectStart
from accelsurf.levelset import Workers
from accelsurf.segmentation.run_setup import EnergyLike
from accelsurf.settings.edits import Correction
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.tracking import entering, evidence, parts
from accelsurf.tracking.carried_mesh import MeshCarrier
from accelsurf.tracking.evidence import FACTOR, Profile, profile, volume_in_grid
from accelsurf.tracking.followed import Followed, lies_on_border, restored
from accelsurf.tracking.frame_run import Measured, following_settings, measure
from accelsurf.tracking.lineage import Identities
from accelsurf.tracking.momentum import Gains, SurfaceMomentum, Triple
from accelsurf.tracking.momentum_models import make_momentum
from accelsurf.tracking.records import SurfacePiece, TrackedObject


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
        Whether meshes are carried along.
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
        self._config, self._geometry, self._identities, self._workers = config, sequence.geometry, identities, workers
        self._friction = config.friction_for(sequence.times)
        self._energy, self._meshes = energy, meshes
        self._run: RunConfig = following_settings(config.run, config.next_energy)
        self._gains = Gains(*config.gains)
        self.objects: list[Followed] = []

    # -- the first frame -----------------------------------------------------------------------------------

    def start(self, found: Sequence[tuple[int, Measured]], arrival: Arrival, velocity: dict[int, Triple]) -> None:
        """Begin with the objects of a frame; ``velocity`` of those of which it is known."""
        for id, one in found:
            self._add(id, one, arrival, velocity.get(id))

    def _add(self, id: int, found: Measured, arrival: Arrival, velocity: Triple | None) -> Followed:
        """Begin to follow an object."""
        momentum = self._new_momentum()
        momentum.start(found.surface.psi, found.surface.corner, self._geometry, velocity)
        return self._put(id, momentum, found, arrival)

    def _put(self, id: int, momentum: SurfaceMomentum, found: Measured, arrival: Arrival) -> Followed:
        seen = profile(arrival.channels[0], found.surface)
        one = Followed(
            id, momentum, seen, found.volume_mm3, found.area_mm2, momentum.centroid(), momentum.mean_velocity(),
            arrival.time, lies_on_border(found.surface, self._geometry), found.quality, 0,
            MeshCarrier() if self._meshes else None,
        )
        self.objects.append(one)
        self._identities.see(id, arrival.number)
        return one

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
        predicted = {one.id: one.momentum.predict(arrival.duration) for one in self.objects}
        found = self._measure(predicted, arrival)
        self._decide(found, predicted, arrival)
        self._begin_clicked(found, arrival)
        self._divide(found, arrival)
        if self._config.merge == "yes":
            self._merge(arrival)
        self._look_for_more(arrival)
        for one in [one for one in self.objects if one.missing > self._config.max_gap]:
            self._end(one, arrival)
        self.objects.sort(key=lambda one: one.id)
        return self.in_frame(predicted)

    def in_frame(self, predicted: dict[int, SurfacePiece]) -> tuple[TrackedObject, ...]:
        """What is told of the objects in the frame."""
        return tuple(one.in_frame(predicted.get(one.id), self._geometry) for one in self.objects)

    def _measure(self, predicted: dict[int, SurfacePiece], arrival: Arrival) -> dict[int, Measured]:
        """What the frame shows: of those that were seen last, then of the others in what these leave free."""
        there = [one for one in self.objects if predicted[one.id].has_inside]
        starts = {one.id: ObjectStart(one.id, *predicted[one.id]) for one in there}
        first = [starts[one.id] for one in there if one.missing == 0]
        then = [starts[one.id] for one in there if one.missing > 0]
        if arrival.refinements:
            first, then = [*first, *then], []
        run, energy = self._run, self._energy
        found = measure(arrival.channels, first, run, energy, arrival.refinements)
        if then:
            taken = [one.surface for one in found.values() if one.surface.psi.size]
            found |= measure(arrival.channels, then, run, energy, taken=taken)
        return found

    def _decide(
        self, found: dict[int, Measured], predicted: dict[int, SurfacePiece], arrival: Arrival
    ) -> None:
        """Correct the objects that are seen; of the others the prediction stands."""
        clicked = {one.object for one in arrival.refinements if one.kind == "clicks"}
        image, duration = arrival.channels[0], arrival.duration
        for one in self.objects:
            shown = found.get(one.id)
            others = [other.surface for id, other in found.items() if id != one.id]
            if shown is None or not shown.surface.psi.size:
                one.missing += 1
                continue
            now = profile(image, shown.surface, others)
            sure = bool(clicked & {None, one.id})
            if not sure and not self._is_shown(one, shown, now, predicted[one.id]):
                one.missing += 1
                continue
            one.momentum.correct(self._largest(shown).surface, duration, self._gains)
            one.note_seen(shown, now, arrival.time, self._geometry)
            self._identities.see(one.id, arrival.number)

    def _is_shown(self, one: Followed, shown: Measured, now: Profile, predicted: SurfacePiece) -> bool:
        expected, seen = (volume_in_grid(piece.psi, self._geometry) for piece in (predicted, shown.surface))
        if one.at_border:  # the prediction knows only what the border has left; more of it may come in
            expected = max(expected, min(seen, one.whole_mm3))
        ratio = expected / one.volume_mm3 if one.volume_mm3 > 0 else 1.0
        volumes = seen, expected
        areas = shown.area_mm2, one.area_mm2 * ratio ** (2.0 / 3.0)
        return evidence.is_shown(now, one.profile, volumes, areas)

    def _largest(self, shown: Measured) -> Measured:
        """What was found without crumbs, where parts are objects; the parts of a division stay together here."""
        if self._config.divide == "no":
            return shown
        large = parts.separate_parts(shown.surface)
        return shown if len(large) != 1 else shown._replace(surface=large[0])

    # -- identities ----------------------------------------------------------------------------------------

    def _begin_clicked(self, found: dict[int, Measured], arrival: Arrival) -> None:
        """Begin what corrections of the frame have made, and end what they have taken away."""
        if not arrival.refinements:
            return
        ids = {one.id for one in self.objects}
        for id in sorted(found.keys() - ids):
            if found[id].surface.psi.size:
                self._add(id, found[id], arrival, None)
        for one in [one for one in self.objects if one.id not in found and one.is_in_grid]:
            self.objects.remove(one)

    def _divide(self, found: dict[int, Measured], arrival: Arrival) -> None:
        """Let the parts of an object that has come apart be objects of their own."""
        if self._config.divide == "no":
            return
        for one in [one for one in self.objects if one.missing == 0 and one.id in found]:
            pieces = parts.separate_parts(found[one.id].surface)
            if len(pieces) < 2:
                continue
            self.objects.remove(one)
            self._identities.forget(one.id, arrival.number)
            ids = []
            for momentum, piece in zip(one.momentum.split(pieces), pieces, strict=True):
                ids.append(self._identities.new_id())
                self._put(ids[-1], momentum, measured_part(piece, momentum, found[one.id].quality), arrival)
            self._identities.divide(one.id, ids, arrival.number, arrival.before)

    def _merge(self, arrival: Arrival) -> None:
        """Let objects that have become one be one."""
        seen = [one for one in self.objects if one.missing == 0]
        if len(seen) < 2:
            return
        like = evidence.median_profile([one.like for one in seen])
        edge = 0.5 * (like.inner + like.outer)
        pairs = parts.touching([one.momentum.piece for one in seen], arrival.channels[0], edge)
        for group in parts.groups_of(pairs):
            old = [seen[place] for place in group]
            momentum = old[0].momentum.merged([one.momentum for one in old[1:]])
            for one in old:
                self.objects.remove(one)
                self._identities.forget(one.id, arrival.number)
            id = self._identities.new_id()
            self._put(id, momentum, measured_part(momentum.piece, momentum, min(one.quality for one in old)), arrival)
            self._identities.merge([one.id for one in old], id, arrival.number, arrival.before)

    def _look_for_more(self, arrival: Arrival) -> None:
        """Find objects that come back, and where asked for such as enter."""
        absent = [one for one in self.objects if one.missing > 0]
        if not absent and self._config.enter == "no":
            return
        known = [one for one in self.objects if one.missing == 0] or absent
        if not known:
            return
        like = evidence.median_profile([one.like for one in known])
        volumes = [one.whole_mm3 for one in self.objects]
        there = [one.momentum.piece for one in self.objects if one.missing == 0]
        first = entering.appearing(arrival.channels[0], there, like, (min(volumes), max(volumes)))
        if not first:
            return
        starts = [ObjectStart(place, *piece) for place, piece in enumerate(first, start=1)]
        found = measure(arrival.channels, starts, self._run, self._energy, taken=there)
        usual = float(np.median([one.whole_mm3 for one in known]))
        for place in sorted(found):
            self._take_in(found[place], (like, usual), absent, arrival)

    def _take_in(
        self, found: Measured, whole: tuple[Profile, float], absent: list[Followed], arrival: Arrival
    ) -> None:
        """Link what has appeared to an object that was missing, or let it enter.

        ``whole`` is what an object that the border does not cut looks like, and its volume.
        """
        if not found.surface.psi.size:
            return
        found = self._largest(found)
        momentum = self._new_momentum()
        momentum.start(found.surface.psi, found.surface.corner, self._geometry)
        if profile(arrival.channels[0], found.surface).strength(whole[0]) * FACTOR < 1.0:
            return
        place, size = np.array(momentum.centroid()), momentum.volume()
        cut = lies_on_border(found.surface, self._geometry)
        nearest, old = np.inf, None
        for one in absent:
            away = min(
                float(np.linalg.norm(place - np.array(there)))
                for there in (one.centroid, one.predicted_place(arrival.time))
            )
            fits = size <= FACTOR * one.whole_mm3 and (cut or one.whole_mm3 <= FACTOR * size)
            if fits and away < nearest and away <= self._search_range(one, arrival.time):
                nearest, old = away, one
        if old is not None:
            absent.remove(old)
            self.objects.remove(old)
            way = (place - np.array(old.centroid)) / (arrival.time - old.time)
            one = self._add(old.id, found, arrival, (float(way[0]), float(way[1]), float(way[2])))
            whole = old.like, old.whole_mm3
        elif self._config.enter == "yes":
            one = self._put(self._identities.new_id(), momentum, found, arrival)
        else:
            return
        if cut:
            one.whole_profile, one.whole_mm3 = whole[0], max(whole[1], one.volume_mm3)

    def _search_range(self, one: Followed, time: float) -> float:
        """How far from where it was an object may come back, mm: its diameter, and as far as it would have moved."""
        geometry = self._geometry
        if geometry.slice_axis is None:
            diameter = 2.0 * (3.0 * one.whole_mm3 / (4.0 * np.pi)) ** (1.0 / 3.0)
        else:
            diameter = 2.0 * (one.whole_mm3 / geometry.spacing[geometry.slice_axis] / np.pi) ** 0.5
        return float(diameter + np.linalg.norm(one.velocity) * abs(time - one.time))

    def _end(self, one: Followed, arrival: Arrival) -> None:
        """End an object that was not seen for too long."""
        self.objects.remove(one)
        if arrival.before < arrival.number:
            self._identities.end(one.id, one.why_gone)

    def note_missing(self) -> None:
        """Note why objects are not seen in the last frame of a rising order."""
        for one in self.objects:
            if one.missing:
                self._identities.end(one.id, one.why_gone)

    # -- checkpoints ---------------------------------------------------------------------------------------

    def state(self) -> list[dict[str, Any]]:
        """State as a value, for `restore`."""
        return [one.state() for one in self.objects]

    def restore(self, state: Sequence[dict[str, Any]]) -> None:
        """Go back to a `state`."""
        self.objects = [restored(one, self._new_momentum(), self._geometry) for one in state]


def measured_part(piece: SurfacePiece, momentum: SurfaceMomentum, quality: float) -> Measured:
    """What is known of a part of a surface."""
    return Measured(piece, momentum.volume(), momentum.area(), quality)
