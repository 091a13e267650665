"""Movies of a run: the scene that is drawn, its pictures, and the run in a folder of results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import InputError, UsageError
from accelsurf.evolution import StepRecord
from accelsurf.image.volume import Volume
from accelsurf.output import MAX_SIDE, MIN_SIDE, GivenImage, Picture, Report, given_labels
from accelsurf.run import Result, Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.viewer.core.frame import Frame, histories_of_run
from accelsurf.viewer.core.opening import finished_run, report_of

if TYPE_CHECKING:
    from accelsurf.viewer.scene.scene import Scene

#: Size of a picture unless another is asked for, pixels.
SIZE = (1280, 720)
Histories = Sequence[Sequence[StepRecord]]
#: Called with each record and the id of its object (None for one without an id); a true value ends the run.
OnStep = Callable[[StepRecord, int | None], bool | None]


def scene_of_run(
    volume: Volume,
    settings: RunConfig,
    reference: Path | None = None,
    theme: str = "dark",
    color: str = "plain",
    view: str = "corner",
    size: tuple[int, int] = SIZE,
    planes: bool = False,
) -> Scene:
    """Return the scene of a movie; errors as of `Scene`, and of the reference and the settings.

    Parameters
    ----------
    volume : Volume
        The image.
    settings : RunConfig
        Of the run: its names and colours of objects, and the window of grey values.
    reference : Path, optional
        Label map to compare with.
    theme, color, view : str, optional
        As `Scene` and its methods take them.
    size : (int, int), optional
        Pixels.
    planes : bool, optional
        Show the slices in 3D.

    Raises
    ------
    GraphicsError
        When nothing here can draw.
    """
    from accelsurf.viewer.scene.headless import require_graphics

    require_graphics()
    # Only now: where nothing can draw, VTK ends the process.
    from accelsurf import io
    from accelsurf.image.grey_window import parse_window
    from accelsurf.viewer.scene.scene import Scene

    labels, window = given_labels(settings), parse_window(settings.window)
    truth = None if reference is None else io.read_labels(reference, grid=volume.geometry)
    scene = Scene(volume, theme=theme, reference=truth, size=size, window=window)
    scene.name_objects(labels)
    scene.color_by(color)
    scene.tiles.look_from(view)
    scene.show_planes(planes)
    scene.render()
    return scene


@dataclass(frozen=True)
class MovieSettings:
    """Settings of the movie of a run.

    Parameters
    ----------
    every : int
        Steps from one frame to the next; the first and the last step have one too.
    fps : float
        Frames per second.
    orbit : float
        Degrees that the camera turns per second of movie; 0 does not turn it.
    hold : float
        Seconds that the last frame is shown longer, while the camera turns on.
    size : (int, int)
        Width and height, pixels.

    Raises
    ------
    UsageError
        When one of them is out of bounds.
    """

    every: int = 1
    fps: float = 15.0
    orbit: float = 12.0
    hold: float = 2.0
    size: tuple[int, int] = SIZE

    def __post_init__(self) -> None:
        bounds = {
            "every": (1, 1e6),
            "fps": (0.1, 120.0),
            "orbit": (-3600.0, 3600.0),
            "hold": (0.0, 600.0),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                hint = "accelsurf movie --help says what it is"
                raise UsageError(f"{name}: {value:g} was given, expected {low:g} to {high:g}", hint)
        if any(not MIN_SIDE <= side <= MAX_SIDE for side in self.size):
            given = "x".join(str(side) for side in self.size)
            expected = f"sides of {MIN_SIDE} to {MAX_SIDE} pixels"
            raise UsageError(f"size: {given} was given, expected {expected}", "as in 1280x720")

    @property
    def turn(self) -> float:
        """Degrees that the camera turns from picture to picture."""
        return self.orbit / self.fps


def movie_pictures(
    run: Run, scene: Scene, movie: MovieSettings, on_step: OnStep | None = None
) -> Iterator[Picture]:
    """Run to the end and draw the steps; the camera turns from picture to picture.

    Parameters
    ----------
    run : Run
        Without a step yet.
    scene : Scene
        Of the same image.
    movie : MovieSettings
    on_step : callable, optional
        As `OnStep` says.

    Yields
    ------
    ndarray (height, width, 3), uint8
    """
    for number, (frame, histories) in enumerate(frames(run, movie.every, on_step)):
        if number:
            scene.tiles.orbit(movie.turn)
        scene.update(frame, histories)
        yield scene.screenshot()
    for _ in range(math.ceil(movie.hold * movie.fps)):
        scene.tiles.orbit(movie.turn)
        yield scene.screenshot()


def last_picture(run: Run, scene: Scene, on_step: OnStep | None = None) -> Picture:
    """Run to the end and draw the last step; parameters as of `movie_pictures`."""
    ((frame, histories),) = frames(run, None, on_step)
    scene.update(frame, histories)
    return scene.screenshot()


def picture_of_result(result: Result, scene: Scene) -> Picture:
    """Draw a result."""
    scene.update(Frame.of_result(result), [segmented.history for segmented in result.objects])
    return scene.screenshot()


def frames(
    run: Run, every: int | None = 1, on_step: OnStep | None = None
) -> Iterator[tuple[Frame, Histories]]:
    """Run to the end, yielding frame and histories every ``every`` steps and at the last; None: at the last alone."""
    with run:
        for number in _steps(run, on_step):
            if run.stop is not None or (every is not None and number % every == 0):
                yield Frame.of_run(run), histories_of_run(run)


def _steps(run: Run, on_step: OnStep | None) -> Iterator[int]:
    """Run, yielding the number of each step when all objects have made it; ends early when ``on_step`` asks for it."""
    while steps := run.step():
        for step in steps:
            if on_step is not None and on_step(
                step.record, step.object_id if run.has_ids else None
            ):
                run.request_stop()
        yield run.step_number - 1


# -- from a folder of results -----------------------------------------------------------------------------------


def run_of_folder(folder: Path) -> tuple[GivenImage, RunConfig | TrackConfig]:
    """Image and settings of the run or tracking whose results are in a folder: they repeat it, byte for byte.

    Parameters
    ----------
    folder : Path
        Where ``accelsurf segment`` or ``track`` wrote; it must hold one report.

    Raises
    ------
    InputError
        When there is no report or more than one, it is not of a run that can be repeated, or the image is not there.
    """
    report_in(folder)
    found = finished_run(folder)
    assert found is not None  # there is a report
    return found


def result_in_folder(folder: Path, volume: Volume, channels: Sequence[Volume]) -> Result:
    """Return the result in a folder, without a step: from its state, or where none was kept from its label map.

    Parameters
    ----------
    folder : Path
        One that `run_of_folder` reads.
    volume : Volume
        The image that it names.
    channels : sequence of Volume
        Further channels of its file.

    Raises
    ------
    InputError
        When there is neither, or a file was changed since.
    """
    from accelsurf.api import segment
    from accelsurf.interact import read_state, restored

    report = report_in(folder)
    names = report.names
    name = names.get("state", names.get("labels"))
    if name is None:
        raise InputError(f"{report.path}: lists no result", "run segment again")
    if not report.unchanged({file.name for file in report.listed} - {name}):
        raise InputError(
            f"{folder / name}: is missing, or was changed since it was written", "run segment again"
        )
    if "state" in names:
        return restored(read_state(folder / name), volume, channels)
    return segment(volume, labels=str(folder / name))


def report_in(folder: Path) -> Report:
    """Return the one report of a result in a folder.

    Raises
    ------
    InputError
        When there is none, or more than one.
    """
    report = report_of(folder)
    if report is None:
        raise InputError(
            f"{folder}: no report of a run (NAME_report.json) there, expected one",
            "give the image and its settings instead",
        )
    return report
