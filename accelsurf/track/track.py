"""track(): objects through a sequence of images, frame by frame, from a first frame that is segmented as an image.

Several sequences of one scene may be the channels of one. The state after each frame is a file, from which a tracking
goes on to the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike

from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.io import (
    ImageLike,
    VolumeSequence,
    from_library,
    read_sequence,
    read_state_file,
    write_state_file,
)
from accelsurf.levelset import Workers
from accelsurf.run import (
    FREE,
    CheckpointHeader,
    EnergyLike,
    ObjectsLike,
    digest_of,
    refuse_another_run,
    seeded,
    thread_count,
    versions,
)
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track.appearance import Appearance
from accelsurf.track.evidence import Profile
from accelsurf.track.first_frame import OnStep, first_objects, given_objects
from accelsurf.track.followed import Trust
from accelsurf.track.follower import Arrival, Follower
from accelsurf.track.frame_run import Measured
from accelsurf.track.momentum import Triple
from accelsurf.track.records import FrameResult, Identities, Lineage, SurfacePiece

if TYPE_CHECKING:
    from accelsurf.api.options import TrackOptions

#: Voxels along each axis of the frames that warm up kernels, and the radius of the ball in them.
WARMUP_SIDE = 24
WARMUP_RADIUS = 6.0
_BEGIN = "begin anew without --resume, with --overwrite"


class JoinedSequence(ImageSequence):
    """The channels of several sequences, frame by frame; times and grid are the first one's.

    Parameters
    ----------
    first : ImageSequence
    others : sequence of ImageSequence

    Raises
    ------
    InputError
        When they have different numbers of frames; GeometryError when grids differ.
    """

    def __init__(self, first: ImageSequence, others: Sequence[ImageSequence]) -> None:
        self._sequences = (first, *others)
        self.times = first.times
        self.time_unit = first.time_unit
        self.geometry = first.geometry
        self.source = first.source
        self.notes = tuple(
            dict.fromkeys(note for sequence in self._sequences for note in sequence.notes)
        )
        for sequence in others:
            if len(sequence) != len(first):
                raise InputError(
                    f"channel {sequence.source}: it has {len(sequence)} frames, {len(first)} expected"
                )
            if difference := first.geometry.difference(sequence.geometry):
                raise GeometryError(
                    f"channel {sequence.source}: on another grid than the first: {difference}"
                )

    @property
    def frame_values(self) -> int:
        """Number of values of a frame, all channels together."""
        return sum(sequence.frame_values for sequence in self._sequences)

    def _channels(self, number: int) -> list[Volume]:
        return [volume for sequence in self._sequences for volume in sequence.channels(number)]


def open_sequence(source: Path, config: TrackConfig) -> ImageSequence:
    """Open the sequence that is tracked, with the channels that the settings add; the headers are read.

    Parameters
    ----------
    source : Path
        A file with time, a folder of frames, or a pattern of their names.
    config : TrackConfig

    Raises
    ------
    InputError, UsageError
        As `accelsurf.read_sequence`; InputError and GeometryError where channels do not fit together.
    """
    read = partial(
        read_sequence,
        frame_time=config.frame_time,
        frames_from_slices=config.frames_from_slices,
        options=config.run.reading,
    )
    first, *others = map(read, (source, *map(Path, config.run.channel)))
    return JoinedSequence(first, others) if others else first


class Visit(NamedTuple):
    """A frame and the one that is done before it; itself for the first."""

    number: int
    before: int


def visits(config: TrackConfig, count: int) -> list[Visit]:
    """The frames in the order in which they are done.

    Examples
    --------
    >>> [tuple(one) for one in visits(TrackConfig(frame=1, direction="both"), 4)]
    [(1, 1), (2, 1), (3, 2), (0, 1)]
    """
    first = config.frame
    out = [Visit(first, first)]
    if config.direction != "backward":
        out += [Visit(number, number - 1) for number in range(first + 1, count)]
    if config.direction != "forward":
        out += [Visit(number, number + 1) for number in range(first - 1, -1, -1)]
    return out


class Tracking:
    """A tracking: iterate over it, each frame is done when it is asked for; then it has a `lineage`.

    No more than two frames are held at any time, whatever the length of the sequence.

    Parameters
    ----------
    sequence : ImageSequence
    config : TrackConfig
    energy : Energy or callable, optional
        One of the user's own, as for `accelsurf.segment`.
    objects : str, Volume or ndarray, optional
        First voxels of several objects, as for `accelsurf.segment_objects`.
    meshes : bool
        Whether meshes move with the momentum: `TrackedObject.mesh`.
    on_step : callable, optional
        Called with each `StepRecord` of the first frame and the id of its object; a true value ends the tracking.
    checkpoint_to : path-like, optional
        File of the state after each frame. Where it exists the tracking goes on from it, to the same bytes, and yields
        the frames that were not done. It stays when the last one is done: the caller removes it.

    Attributes
    ----------
    config : TrackConfig
        With the seed that was drawn if one is needed and none was given.
    visits : list of Visit
        The frames in the order in which they are done.
    done : int
        How many of them are done.
    warnings : list of str
        Of the first frame.
    doubtful : list of int
        Frames, as they were done, whose tracks cannot be trusted: see `Follower.is_doubtful`.
    interrupted : bool
        Whether ``on_step`` has ended the tracking.

    Raises
    ------
    UsageError
        When a frame does not exist.
    InputError
        When the checkpoint is damaged or of another tracking.
    """

    def __init__(
        self,
        sequence: ImageSequence,
        config: TrackConfig,
        energy: EnergyLike | None = None,
        objects: ObjectsLike | None = None,
        meshes: bool = False,
        on_step: OnStep | None = None,
        checkpoint_to: str | Path | None = None,
    ) -> None:
        self._check(sequence, config)
        self.sequence = sequence
        self._energy = energy
        self._objects = objects
        self._on_step = on_step
        self.config = config.replace(run=seeded(config.run))
        self._meshes, self._path = meshes, None if checkpoint_to is None else Path(checkpoint_to)
        self.visits, self.done = visits(config, len(sequence)), 0
        self.warnings: list[str] = []
        self.doubtful: list[int] = []
        self.interrupted = False
        self._identities = Identities()
        self._first: tuple[tuple[int, Measured], ...] = ()
        self._velocities: dict[int, Triple] = {}
        self._trust: dict[int, Trust] = {}
        self._workers = Workers(thread_count(config.run))
        self._follower = self._new_follower()
        if self._path is not None and self._path.exists():
            self._restore(self._path)

    @staticmethod
    def _check(sequence: ImageSequence, config: TrackConfig) -> None:
        count = len(sequence)
        for key, number in (
            ("frame", config.frame),
            *(("correct", correction.frame) for correction in config.correct),
        ):
            if number >= count:
                raise UsageError(f"{key}: frame {number} was given, expected 0 to {count - 1}")

    def _new_follower(self) -> Follower:
        return Follower(
            self.config, self.sequence, self._identities, self._workers, self._energy, self._meshes
        )

    # -- to run --------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[FrameResult]:
        """The frames that are not done yet, each in the order of `visits`."""
        while self.done < len(self.visits) and not self.interrupted:
            yield self.step()
            self.save()  # the caller is done with the frame too
        self._workers.close()

    def step(self) -> FrameResult:
        """Follow the objects into the next frame of the way, and return its result."""
        began, (number, before) = time.perf_counter(), self.visits[self.done]
        times = self.sequence.times
        wanted = tuple(
            correction.model_copy(update={"frame": -1})
            for correction in self.config.correct
            if correction.frame == number
        )
        arrival = Arrival(
            number,
            before,
            times[number],
            times[number] - times[before],
            self._frame(number),
            wanted,
        )
        if number == before:
            objects = self._begin_at(arrival)
        else:
            if before == self.config.frame and number < before and self.done > 1:
                self._turn_back()
            objects = self._follower.advance(arrival)
            self.doubtful += [number] if self._follower.is_doubtful else []
            if before == self.config.frame and number > before:
                self._note_velocities()
        self.done += 1
        if (
            self.done == len(self.visits)
            or self.visits[self.done].number < self.visits[self.done - 1].number
        ):
            if number >= before:
                self._follower.note_missing()
        return FrameResult(
            number, arrival.time, arrival.channels[0], objects, time.perf_counter() - began
        )

    def _frame(self, number: int) -> list[Volume]:
        channels = self.sequence.channels(number)
        if difference := self.sequence.geometry.difference(channels[0].geometry):
            raise InputError(f"frame {number} lies on another grid than the sequence: {difference}")
        return channels

    def _begin_at(self, arrival: Arrival) -> Any:
        """Begin with the labels that are given, or segment the first frame."""
        given = (
            None
            if arrival.refinements
            else given_objects(self.config.run, self._objects, self.sequence.geometry)
        )
        if given is not None:
            self._first = given
        else:
            first = first_objects(
                arrival.channels,
                self.config.run,
                arrival.refinements,
                self.config.divide == "yes",
                self._energy,
                self._objects,
                self._on_step,
            )
            self._first, self.interrupted = first.found, first.interrupted
            self.warnings += first.warnings
        self._follower.start(self._first, arrival, {}, {})
        if given is not None and len(self.visits) > 1:
            self._trust = self._follower.learn_trust(arrival)
        return self._follower.in_frame({})

    def _turn_back(self) -> None:
        """Go on from the first frame again, in falling order, with the velocities that were found after it."""
        first = self.config.frame
        arrival = Arrival(first, first, self.sequence.times[first], 0.0, self._frame(first))
        self._follower = self._new_follower()
        self._follower.start(self._first, arrival, self._velocities, self._trust)

    def _note_velocities(self) -> None:
        """Note the velocities of the first objects after the first step."""
        ids = {id for id, _ in self._first}
        self._velocities = {
            followed.id: followed.velocity
            for followed in self._follower.objects
            if followed.id in ids and followed.missing == 0
        }

    @property
    def lineage(self) -> Lineage:
        """All tracks and links of the frames that are done."""
        return self._identities.lineage()

    def close(self) -> None:
        """End the threads."""
        self._workers.close()

    # -- checkpoints ---------------------------------------------------------------------------------------

    def save(self) -> None:
        """Write the state after a frame."""
        if self._path is None or self.interrupted:
            return
        write_state_file(self._path, SavedTracking(self._header, self._state()), TYPES)

    @cached_property
    def _header(self) -> CheckpointHeader:
        # Once: it reads the first frame.
        return header_of(self.sequence, self.config, self._meshes)

    def _state(self) -> TrackState:
        return TrackState(
            self.done,
            self.config.run.seed,
            self._first,
            dict(self._velocities),
            self._trust,
            self._identities.state(),
            tuple(self._follower.state()),
            tuple(self.warnings),
            tuple(self.doubtful),
        )

    def _restore(self, path: Path) -> None:
        header, state = read_tracking(path)
        if state.seed is not None and self.config.run.seed != state.seed:
            self.config = self.config.replace(run=self.config.run.replace(seed=state.seed))
        refuse_another_run(path, header, self._header, "another sequence")
        self._identities.restore(state.identities)
        self._follower = self._new_follower()
        self._follower.restore(state.objects)
        self.done, self.warnings, self.doubtful = (
            state.done,
            list(state.warnings),
            list(state.doubtful),
        )
        self._first = state.first
        self._velocities = state.velocities
        self._trust = state.trust


def track(
    sequence: ImageSequence | str | os.PathLike[str] | Sequence[ImageLike] | ArrayLike,
    config: TrackConfig | None = None,
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
    energy: EnergyLike | None = None,
    objects: ObjectsLike | ImageLike | None = None,
    meshes: bool = False,
    on_step: Callable[[Any, int], bool | None] | None = None,
    checkpoint_to: str | Path | None = None,
    **options: Unpack[TrackOptions],
) -> Tracking:
    """Follow objects through a sequence of images.

    Parameters
    ----------
    sequence : path-like, sequence of image, ndarray, or ImageSequence
        Input or result of `accelsurf.read_sequence`, images as `accelsurf.segment` takes them, or an array whose
        first axis is time, also of dask, torch or xarray.
    config : TrackConfig, optional
    spacing : float, str or (hz, hy, hx), optional
        mm, of arrays; 1 by default.
    energy, objects, meshes, on_step, checkpoint_to : optional
        As of `Tracking`; the objects also as any image.
    **options
        Settings by name, of tracking or of the run on each frame; they override ``config``.

    Returns
    -------
    Tracking
        To be iterated: it yields a `FrameResult` for each frame; its ``lineage`` says who came from whom.

    Raises
    ------
    UsageError, InputError
        As of `accelsurf.segment`, and when a frame does not exist.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((20, 20, 30)) - 9.5
    >>> frames = [100.0 * (z**2 + y**2 + (x - 2 * n) ** 2 < 36) for n in range(4)]
    >>> tracking = track(frames, start="ball:9,9,9,4vox")
    >>> [round(result.objects[0].centroid[0], 1) for result in tracking]
    [9.5, 11.5, 13.5, 15.5]
    >>> tracking.lineage.tracks[0]
    Track(id=1, first=0, last=3, gaps=(), end='end of sequence')
    """
    changes: dict[str, Any] = {**options}
    if isinstance(energy, str):
        changes["energy"], energy = energy, None
    settings = config or TrackConfig()
    settings = settings.replace(**changes) if changes else settings
    starts = (
        os.fspath(objects) if isinstance(objects, os.PathLike) else from_library(objects, "objects")
    )
    if not isinstance(sequence, (ImageSequence, str, os.PathLike)):
        sequence = VolumeSequence(sequence, settings.frame_time, spacing)
    elif spacing is not None:
        raise InputError(
            "spacing given together with a sequence, which has its own", "leave spacing out"
        )
    frames = (
        sequence if isinstance(sequence, ImageSequence) else open_sequence(Path(sequence), settings)
    )
    return Tracking(frames, settings, energy, starts, meshes, on_step, checkpoint_to)


def warm_up() -> None:
    """Call the kernels that only a tracking calls, for ``accelsurf warmup``.

    A ball through three frames, with a mesh that is moved along, the way of the observer gone in part.
    """
    frames = [_warmup_frame(x) for x in (-1.0, 0.0, 1.0)]
    start = frames[0].with_array((frames[0].array > 0.5).astype(np.uint8))
    config = TrackConfig(observer="0.7,0.5", levels=1, max_steps=12)
    for _ in Tracking(VolumeSequence(frames), config, objects=start, meshes=True):
        pass


def _warmup_frame(shift: float) -> Volume:
    z, y, x = np.indices([WARMUP_SIDE] * 3) - WARMUP_SIDE / 2
    return Volume.from_array(
        (z**2 + y**2 + (x - shift) ** 2 < WARMUP_RADIUS**2).astype(np.float32), 1.0
    )


class TrackState(NamedTuple):
    """A tracking after a frame.

    Attributes
    ----------
    done : int
        How many frames are done.
    seed : int or None
    first : tuple of (int, Measured)
        Objects of the first frame.
    velocities : dict of int to (x, y, z)
        Of these, after the first step.
    trust : dict of int to Trust
        Of those that were given as labels.
    identities : dict
    objects : tuple of dict
        Those that are followed.
    warnings : tuple of str
    doubtful : tuple of int
    """

    done: int
    seed: int | None
    first: tuple[tuple[int, Measured], ...]
    velocities: dict[int, Triple]
    trust: dict[int, Trust]
    identities: dict[str, Any]
    objects: tuple[dict[str, Any], ...]
    warnings: tuple[str, ...]
    doubtful: tuple[int, ...]


class SavedTracking(NamedTuple):
    """A tracking as it is written: its ``state`` after a frame, with the ``header`` that says of which one."""

    header: CheckpointHeader
    state: TrackState


TYPES: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Appearance,
        CheckpointHeader,
        Measured,
        Profile,
        SavedTracking,
        SurfacePiece,
        TrackState,
        Trust,
    )
}


def header_of(sequence: ImageSequence, config: TrackConfig, meshes: bool) -> CheckpointHeader:
    """The header of a tracking's states, the same at every frame.

    Of the sequence it has grid, times and the voxels of the first frame that is done.
    """
    sha, geometry = hashlib.sha256(), sequence.geometry
    sha.update(
        f"{geometry.shape}{geometry.spacing}{geometry.origin}{sequence.times}{sequence.time_unit}".encode()
    )
    sha.update(
        digest_of(
            {"direction": geometry.direction, "image": sequence.frame(config.frame).array}
        ).encode()
    )
    run = config.run.model_dump(mode="json", exclude=set(FREE))
    settings = {**run, **config.model_dump(mode="json", exclude={"run"}), "meshes": meshes}
    sha.update(json.dumps(settings, sort_keys=True).encode())
    return CheckpointHeader(versions(), sha.hexdigest(), settings)


def read_tracking(path: Path) -> SavedTracking:
    """Read a state of any tracking.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged or of another version.
    """
    return read_state_file(path, SavedTracking, TYPES, lambda saved: saved, _BEGIN)
