"""Through the frames of a sequence: slider, keys, play; tracked objects with their prediction beside the correction."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.viewer.actions.slices import SlicesFeature
from accelsurf.viewer.actions.tool import AllActions, Feature, Key, whole
from accelsurf.viewer.core.sequence_view import SequenceView
from accelsurf.viewer.core.status import Status, View

#: Frames a second while they play; fewer where one takes longer to read and draw.
RATE = 8.0
#: Requests for the frame that runs are made in: elsewhere they would change a run that is not seen.
OF_A_RUN = (
    "play",
    "toggle",
    "step",
    "back",
    "go_to",
    "restart",
    "undo",
    "redo",
    "change",
    "next_uncertain",
    "uncertain",
    "save",
    "object_add",
    "object_remove",
    "object_merge",
    "object_split",
    "object_name",
    "object_color",
    "object_visible",
    "object_opacity",
    "set",
    "set_term",
    "type_energy",
    "take_answer",
)


class FramesFeature(Feature):
    """Shows one frame of a sequence at a time; an image without time has none.

    Attributes
    ----------
    number : int
        The frame that is shown.
    is_playing : bool
        Whether the frames follow each other by themselves.
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._frames: SequenceView | None = actions.frames
        self.number, self.is_playing = 0, False
        self._due = 0.0
        #: The last view of the run, for when its frame is shown again.
        self._view: View | None = None
        if self._frames is not None:
            self.number = self._frames.home
            tracks = self._frames.tracks
            if tracks is not None:
                # Each has the colour of its place among all, whichever are in the first frame.
                actions.scene.styles.choose_colors(tracks.ids)
                self._draw()

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "frame": self._go_to,
            "step_frame": self._step,
            "play_frames": self._play,
            "copy_correction": self._copy_correction,
        }

    def keys(self) -> Mapping[str, Key]:
        if self._frames is None:
            return {}
        return {
            ",": Key("step_frame", (-1,), "frame before this one"),
            ".": Key("step_frame", (1,), "next frame"),
            "X": Key("play_frames", (), "play the frames, or stop"),
            "/": Key(
                "copy_correction",
                (),
                "copy the place under the mouse as a correction of this frame",
            ),
        }

    def state(self, status: Status) -> dict[str, Any]:
        frames = self._frames
        return {
            "frames": 0 if frames is None else len(frames),
            "frame": self.number,
            "frames_play": self.is_playing,
            "frame_words": "" if frames is None else frames.said(self.number),
            "frame_lines": self._lines(),
            "as_correction": self._correction(),
        }

    def _lines(self) -> str:
        """Return the legend of the lines of tracked objects."""
        if self._frames is None or self._frames.tracks is None:
            return ""
        if self._frames.tracks.has_predictions:
            return "dashed and translucent blue: predicted; in its colour: corrected"
        return "from label maps; track with --also surfaces to see predictions"

    # -- the run beside the frames ------------------------------------------------------------------------

    @property
    def shows_run(self) -> bool:
        """Test if the run is shown: in its frame, where no tracked objects are."""
        return self._frames is None or (
            self._frames.tracks is None and self.number == self._frames.home
        )

    def note_view(self, view: View) -> None:
        """Take a new view of the run; it is drawn when its frame is shown."""
        self._view = view

    def refuse_elsewhere(self, name: Any) -> None:
        """Refuse a request that steers the run where it is not seen.

        Raises
        ------
        UsageError
        """
        if self.shows_run or self._frames is None or name not in OF_A_RUN:
            return
        if self._frames.tracks is not None:
            raise UsageError(
                f"{name}: tracked objects are shown, a run is made without them; / copies a correction"
            )
        raise UsageError(
            f"{name}: the run is in frame {self._frames.home}, frame {self.number} is shown"
        )

    def refuse_tool(self, name: str) -> None:
        """Refuse a tool that changes the run where it is not seen.

        Raises
        ------
        UsageError
        """
        if not self.shows_run and name != "look":
            self.refuse_elsewhere(OF_A_RUN[0])

    # -- to go ----------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Go on while the frames play."""
        if self.is_playing and time.monotonic() >= self._due:
            try:
                self._show((self.number + 1) % len(self._checked()))
            except Exception:
                self.is_playing = False
                raise
            self._due = time.monotonic() + 1.0 / RATE

    def _checked(self) -> SequenceView:
        if self._frames is None:
            raise UsageError("frame: the image has no time")
        return self._frames

    def _go_to(self, number: Any) -> None:
        self._show(whole(number, 0, len(self._checked()) - 1))

    def _step(self, count: Any) -> None:
        number = self.number + whole(count, -(10**6), 10**6)
        self._show(min(max(number, 0), len(self._checked()) - 1))

    def _play(self) -> None:
        self._checked()
        self.is_playing = not self.is_playing

    def _show(self, number: int) -> None:
        """Show a frame; if it cannot be read, the previous one stays."""
        before, self.number = self.number, number
        try:
            self._draw()
        except Exception:
            self.number = before
            raise

    def _draw(self) -> None:
        frames, scene = self._checked(), self.actions.scene
        volume, frame = frames.volume(self.number), frames.frame(self.number)
        scene.show_image(volume)
        if self.shows_run and self._view is not None:
            scene.update(self._view.frame, self._view.histories)
        else:
            scene.update(frame)

    def _copy_correction(self) -> None:
        """Copy the words with which ``accelsurf track`` corrects this frame at the place under the mouse."""
        self._checked()
        self.actions.copy(self._correction())

    def _correction(self) -> str:
        if self._frames is None:
            return ""
        return f'--correct "frame={self.number} inside={self.actions.feature(SlicesFeature).read_out()["as_point"]}"'
