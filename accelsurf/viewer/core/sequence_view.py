"""A sequence that is looked at: three frames in memory, and the tracked objects of each."""

from __future__ import annotations

from collections import OrderedDict

from accelsurf.evolution import StepRecord
from accelsurf.grid import pyramid
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.track import SavedTracks, SurfacePiece
from accelsurf.viewer.core.frame import Frame, SurfaceFrame

#: Frames that stay in memory.
MAX_FRAMES = 3
_NO_STEP = StepRecord._make(StepRecord._field_defaults.get(name, 0) for name in StepRecord._fields)


class SequenceView:
    """Frames of a sequence, and the objects tracked in them.

    Parameters
    ----------
    sequence : ImageSequence
    home : int, optional
        The frame that runs are made in.
    tracks : SavedTracks, optional
        Of the same sequence.
    """

    def __init__(
        self, sequence: ImageSequence, home: int = 0, tracks: SavedTracks | None = None
    ) -> None:
        self.sequence = sequence
        self.home = home
        self.tracks = tracks
        self._level = pyramid.levels(sequence.geometry.shape, sequence.geometry.spacing, 1)[0]
        self._volumes: OrderedDict[int, Volume] = OrderedDict()
        self._drawn: OrderedDict[int, Frame] = OrderedDict()

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.sequence)

    def volume(self, number: int) -> Volume:
        """A frame, read now unless it is one of the last that were.

        Raises
        ------
        InputError
            When it cannot be read.
        """
        if number not in self._volumes:
            while len(self._volumes) >= MAX_FRAMES:  # before it is read: never more in memory
                self._volumes.popitem(last=False)
            self._volumes[number] = self.sequence.frame(number)
        self._volumes.move_to_end(number)
        return self._volumes[number]

    def said(self, number: int) -> str:
        """Number and time of a frame in words."""
        words = f"frame {number} of 0 to {len(self) - 1}"
        unit = self.sequence.time_unit
        return words if unit == "frame" else f"{words}, {self.sequence.times[number]:.4g} {unit}"

    def frame(self, number: int) -> Frame:
        """Return the frame of the tracked objects; without tracks it has none.

        Raises
        ------
        InputError
            When a file of the tracks is damaged.
        """
        if self.tracks is None:
            return Frame((), said=self.said(number))
        if number not in self._drawn:
            while len(self._drawn) >= MAX_FRAMES:
                self._drawn.popitem(last=False)
            self._drawn[number] = self._tracked(self.tracks, number)
        self._drawn.move_to_end(number)
        return self._drawn[number]

    def _tracked(self, tracks: SavedTracks, number: int) -> Frame:
        drawn, paths = tracks.drawn(number), tracks.paths(number)
        return Frame(
            tuple(self._surface(tracked.id, tracked.surface) for tracked in drawn),
            predicted=tuple(
                self._surface(tracked.id, tracked.predicted)
                for tracked in drawn
                if tracked.predicted is not None
            ),
            paths=tuple(paths[tracked.id] for tracked in drawn if tracked.id in paths),
            said=self.said(number),
        )

    def _surface(self, id: int, piece: SurfacePiece) -> SurfaceFrame:
        voxel = 1.0
        for step in self.sequence.geometry.spacing:
            voxel *= step
        record = _NO_STEP._replace(volume_mm3=float((piece.psi < 0).sum()) * voxel)
        corner = piece.corner
        return SurfaceFrame(id, record, self._level, piece.psi, corner, 1, corner, piece.psi.shape)
