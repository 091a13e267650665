"""The scene of a movie in a process of its own: a fault in a graphics library costs a picture, never the run.

The process imports VTK once and stays for all pictures. It ends when the one that began it does, however that ends:
then its pipe is closed.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from accelsurf.errors import AccelsurfError
from accelsurf.evolution.records import StepRecord
from accelsurf.image.volume import Volume
from accelsurf.output.pictures.movies import Picture
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame

if TYPE_CHECKING:
    from accelsurf.viewer.scene.scene import Scene

#: What the process runs.
PROGRAM = f"import {__name__} as drawing; drawing.serve()"
#: How often a picture is tried, and after how many in a row that were lost none is tried any more.
TRIES, MAX_LOST = 2, 3
HINT = "run it again; if it fails again, update the graphics driver, or install OSMesa, which draws without one"

Histories = Sequence[Sequence[StepRecord]]


@dataclass(frozen=True)
class SceneRecipe:
    """Recipe of a scene, as `accelsurf.viewer.scene.scene.Scene` and its methods take it.

    Attributes
    ----------
    volume : Volume
        The image.
    settings : RunConfig
        Of the run: its names and colours of objects, and the window of grey values.
    reference : Path or None
        Label map to compare with.
    theme, color, view : str
    size : (int, int)
        Pixels.
    shows_planes : bool
    """

    volume: Volume
    settings: RunConfig
    reference: Path | None = None
    theme: str = "dark"
    color: str = "plain"
    view: str = "corner"
    size: tuple[int, int] = (1280, 720)
    shows_planes: bool = False

    def scene(self) -> Scene:
        """Make it; errors as of `Scene`, and of the reference and the settings.

        Where nothing can draw, VTK ends the process.
        """
        import pyvista

        from accelsurf import io
        from accelsurf.image.grey_window import parse_window
        from accelsurf.viewer.scene.colors import given_styles
        from accelsurf.viewer.scene.scene import Scene

        styles, window = given_styles(self.settings), parse_window(self.settings.window)
        truth = (
            None
            if self.reference is None
            else io.read_labels(self.reference, grid=self.volume.geometry)
        )
        layout = Scene.layout(self.volume.geometry)
        plotter = pyvista.Plotter(off_screen=True, window_size=list(self.size), **layout)
        scene = Scene(
            self.volume, theme=self.theme, reference=truth, plotter=plotter, window=window
        )
        scene.restyle(styles)
        scene.color_by(self.color)
        scene.tiles.look_from(self.view)
        scene.show_planes(self.shows_planes)
        scene.render()
        return scene


class _Request(NamedTuple):
    """A picture that is asked for: how often the camera has been turned, and frames to show one after the other."""

    frames: tuple[tuple[Frame, Histories], ...]
    turns: int
    degrees: float


class _Ended(Exception):
    """The process has ended; says how."""


class DrawingProcess:
    """The process that draws; one that dies is started again, and the picture is tried once more.

    Parameters
    ----------
    tell : callable
        Called with a line about each picture that could not be drawn.
    degrees : float, optional
        By how much the camera is turned after each picture.
    """

    def __init__(self, tell: Callable[[str], None], degrees: float = 0.0) -> None:
        self._tell, self._degrees = tell, degrees
        self._recipe: SceneRecipe | None = None
        #: The frame that is shown, and the first with a surface, through whose middle the slices go.
        self._shown: tuple[Frame, Histories] | None = None
        self._first: Frame | None = None
        self._picture: Picture | None = None
        self._count = self._lost = 0
        self._process: subprocess.Popen[bytes] | None = self._started()

    @property
    def pid(self) -> int | None:
        """Number of the process; None while there is none."""
        return None if self._process is None else self._process.pid

    def make_scene(self, recipe: SceneRecipe) -> None:
        """Make the scene.

        Raises
        ------
        GraphicsError
            When nothing here can draw, or the process ends before it has a scene; else as of `SceneRecipe.scene`.
        """
        self._recipe = recipe
        self._tried(None)
        if self._process is None:
            raise self.failure()

    def draw(self, frame: Frame | None = None, histories: Histories = ()) -> Picture | None:
        """Draw a frame, or the one before once more; the camera is turned after each picture.

        Returns
        -------
        ndarray (height, width, 3), uint8, or None
            The picture before where this one could not be drawn; None if there was none before.

        Raises
        ------
        GraphicsError
            When several pictures in a row could not be drawn.
        """
        if frame is not None:
            self._shown = (frame, histories)
            if self._first is None and frame.has_surface:
                self._first = frame
        picture = self._tried(frame)
        self._count += 1
        if picture is not None:
            self._picture, self._lost = picture, 0
            return picture
        self._lost += 1
        if self._lost >= MAX_LOST:
            raise self.failure()
        instead = "it is left out" if self._picture is None else "the one before is shown again"
        self._tell(
            f"picture {self._count} could not be drawn: the process that draws ended {TRIES} times; {instead}"
        )
        return self._picture

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def failure(self) -> AccelsurfError:
        """Return the error that pictures cannot be drawn, a GraphicsError, with what to install where that helps."""
        # Not with the module: it loads VTK, which only the process that draws needs.
        from accelsurf.viewer.scene.headless import GraphicsError, require_graphics

        try:
            require_graphics()
        except GraphicsError as error:
            return error
        return GraphicsError(
            "no picture can be drawn: the process that draws ends each time it is started", HINT
        )

    def _tried(self, frame: Frame | None) -> Picture | None:
        """Draw with the process that there is, else with a new one; None where each of them ends over it.

        Before the first frame only the scene is made.
        """
        for _ in range(TRIES):
            try:
                if self._process is None:
                    self._process = self._started()
                    return self._drawn_anew()
                if self._shown is None:
                    return self._drawn_anew()
                frames = () if frame is None else (self._shown,)
                return self._asked(_Request(frames, self._count, self._degrees))
            except _Ended:
                self.close()
        return None

    def _drawn_anew(self) -> Picture | None:
        """Make the scene in a new process, as if it had drawn all frames so far, and draw."""
        self._asked(self._recipe)
        if self._shown is None:
            return None
        frames = (
            (self._shown,)
            if self._first in (None, self._shown[0])
            else ((self._first, ()), self._shown)
        )
        return self._asked(_Request(frames, self._count, self._degrees))

    def _started(self) -> subprocess.Popen[bytes]:
        # As here, and nothing from the current folder (-P): somebody's data lies there.
        found = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder),
        }
        return subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM],
            env=found,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    def _asked(self, request: SceneRecipe | _Request | None) -> Picture | None:
        """The answer of the process; raises what it raised there, and `_Ended` when there is none."""
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        try:
            pickle.dump(request, process.stdin, protocol=5)
            process.stdin.flush()
            answer = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            raise _Ended from error
        if isinstance(answer, Exception):
            raise answer
        picture: Picture | None = answer
        return picture


def serve() -> None:
    """Draw what is asked for on stdin, until it is closed; the answers go to stdout."""
    # Ctrl-C reaches this process too; the one that asks decides what is drawn after it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Also not through sys.stdin and sys.stdout: what libraries print is no answer.
    with os.fdopen(os.dup(0), "rb") as requests, os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        import accelsurf.viewer.scene.scene  # noqa: F401  while the image is read elsewhere

        scene, turns = None, 0
        answer: Picture | Exception | None
        while True:
            try:
                request = pickle.load(requests)
                if isinstance(request, SceneRecipe):
                    scene, answer = request.scene(), None
                else:
                    answer, turns = _drawn(scene, request, turns), request.turns
            except EOFError:
                return
            except Exception as error:
                is_plain = isinstance(error, (AccelsurfError, MemoryError))
                answer = error if is_plain else RuntimeError(f"{type(error).__name__}: {error}")
            try:
                pickle.dump(answer, answers, protocol=5)
                answers.flush()
            except OSError:  # nobody waits for it any more
                os._exit(0)


def _drawn(scene: Any, request: _Request, turns: int) -> Picture:
    """The picture that is asked for; the camera has been turned so often before."""
    for _ in range(request.turns - turns):
        scene.tiles.orbit(request.degrees)
    for frame, histories in request.frames:
        scene.update(frame, histories)
    picture: Picture = scene.screenshot()
    return picture
