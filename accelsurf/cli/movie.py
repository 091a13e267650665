"""``accelsurf movie``: a movie, or one picture, of a run."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from accelsurf.cases import Watcher
from accelsurf.cli.options import (
    FILES,
    WITHOUT_FILES,
    Display,
    File,
    Output,
    Overwrite,
    given_options,
    required,
    run_config,
    settings_class,
)
from accelsurf.errors import InputError, UsageError
from accelsurf.evolution import Stop
from accelsurf.io import format_of, image_name, refuse_unfinished
from accelsurf.output import GivenImage, inputs_of, refuse_existing, report_name
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.settings.wording import shown

if TYPE_CHECKING:
    from accelsurf.run import Result, Run
    from accelsurf.viewer import MovieSettings, Scene

MOVIE = Group("Movie", sort_key=0)
#: It draws the run; ``color`` is the quantity that colours surfaces.
RunSettings = settings_class(
    "RunSettings", groups=WITHOUT_FILES, further=("name", "label_table", "window")
)


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """Content and number of the pictures."""

    color: Annotated[Literal["plain", "speed", "force", "density"], Parameter(group=MOVIE)] = (
        "plain"
    )
    """Colour the surfaces: plain, or by outward speed, force or density."""

    theme: Annotated[Literal["dark", "light"], Parameter(group=MOVIE)] = "dark"
    """Colours of the background and text: dark or light."""

    every: Annotated[int, Parameter(group=MOVIE)] = 1
    """Draw a frame every N steps."""

    fps: Annotated[float, Parameter(group=MOVIE)] = 15.0
    """Frames per second."""

    size: Annotated[str, Parameter(group=MOVIE)] = "1280x720"
    """Width and height, pixels."""

    view: Annotated[
        Literal["corner", "front", "back", "left", "right", "top", "bottom"], Parameter(group=MOVIE)
    ] = "corner"
    """Direction of the camera at the beginning."""

    orbit: Annotated[float, Parameter(group=MOVIE)] = 12.0
    """Rotation of the camera, degrees per second of movie; 0 for none."""

    hold: Annotated[float, Parameter(group=MOVIE)] = 2.0
    """Seconds for which the last frame stays."""

    planes: Annotated[bool, Parameter(negative=(), show_default=False, group=MOVIE)] = False
    """Show the three slices in 3D."""


def movie(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
    *,
    output: Output = None,
    config: File = None,
    reference: File = None,
    overwrite: Overwrite = False,
    preview: Annotated[bool, Parameter(negative=(), show_default=False, group=MOVIE)] = False,
    look: Look | None = None,
    settings: RunSettings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Make a movie of a run; needs no screen.

    Runs as accelsurf segment does, with the same options and the same result, and draws the steps; with --objects each
    object in a colour of its own. Given a folder with the results of a run, it repeats that run; with --preview it
    draws the result that is there. Given a folder of accelsurf track, it draws the tracks that are there, a slice of
    each frame.

    Parameters
    ----------
    input
        The image, or a folder with the results of a run or of accelsurf track.
    output
        The movie: .mp4, .gif or .webp; with --preview .png. Or the folder for NAME_movie.mp4 or NAME_movie.png.
    config
        TOML file with settings; options given here override it.
    reference
        Label map on the image's grid to show, with the Dice coefficient.
    overwrite
        Replace the movie if it exists.
    preview
        Write one PNG of the last step, or of the result in a folder, instead of a movie.
    """
    from accelsurf.output import write_png
    from accelsurf.run import Run
    from accelsurf.viewer import MovieSettings, picture_of_result, result_in_folder, scene_of_run

    look, display = look or Look(), display or Display()
    source, target = required(input, "INPUT"), required(output, "-o FILE, the movie,")
    on_disk = preview and _has_results(source)
    if on_disk and look.color != "plain":
        raise UsageError(
            f"--color: {look.color} was given for a result, which has none", "give its image"
        )
    movie_settings = MovieSettings(look.every, look.fps, look.orbit, look.hold, _size(look.size))
    given, run_settings = _source(source, settings, config)
    image = given.path
    if target.is_dir():
        target /= f"{image_name(image)}_movie.{'png' if preview else 'mp4'}"
    if isinstance(run_settings, TrackConfig):
        _refuse_with_tracks(look, preview, reference)
    _check_target(target, preview, movie_settings.size)
    refuse_existing({"movie": target}, overwrite, inputs_of(image, run_settings, reference, config))
    watcher = Watcher(display)
    if isinstance(run_settings, TrackConfig):
        frames = _movie_of_tracks(source, given, run_settings, target)
        if not display.quiet:
            print(f"{image.name}: {frames} frames\n  movie  {target.absolute()}")
        return 0
    volume, *more = given.read("run accelsurf segment again")
    shown = look.theme, look.color, look.view, movie_settings.size, look.planes
    scene = scene_of_run(volume, run_settings, reference, *shown)
    drawn: Run | Result
    try:
        if on_disk:
            drawn, kind = result_in_folder(source, volume, more), "picture"
            write_png(target, picture_of_result(drawn, scene))
        else:
            with watcher.watch(image.name, run_settings.max_steps, "writing the steps so far"):
                drawn = Run(volume, run_settings, None, more)
                kind = _draw(drawn, scene, target, None if preview else movie_settings, watcher)
    finally:
        scene.close()
    watcher.note(
        f"the {'picture' if preview else 'movie'} of the steps so far is written: {target.absolute()}"
    )
    if not display.quiet and drawn.stop is not None:
        print(f"{image.name}: {_ending(drawn.stop, drawn.has_ids)}\n  {kind}  {target.absolute()}")
    return watcher.exit_code(0)


def _check_target(target: Path, preview: bool, size: tuple[int, int]) -> None:
    """Refuse a file that cannot be written here, before anything is computed."""
    from accelsurf.output import MOVIE_FORMATS, check_target

    if not preview:
        if target.suffix.lower() == ".png":
            formats = ", ".join(MOVIE_FORMATS)
            raise UsageError(
                f"{target.name}: .png was given, expected {formats}", "or add --preview"
            )
        check_target(target, size)
    elif target.suffix.lower() != ".png":
        raise UsageError(
            f"{target.name}: {target.suffix or 'no suffix'} was given, expected .png with --preview",
            f"write {target.with_suffix('.png').name}, or leave --preview out",
        )


def _refuse_with_tracks(look: Look, preview: bool, reference: Path | None) -> None:
    """Refuse options that a movie of tracks, in slices, does not have."""
    changed = [field.name for field in fields(Look) if getattr(look, field.name) != field.default]
    for name in [*changed, *["reference"] * (reference is not None)]:
        raise UsageError(
            f"--{name} was given for a folder of tracks, whose movie shows slices", "leave it out"
        )
    if preview:
        raise UsageError(
            "--preview was given for a folder of tracks",
            "NAME_preview.png in it is the picture; for a movie leave --preview out",
        )


def _movie_of_tracks(folder: Path, given: GivenImage, config: TrackConfig, target: Path) -> int:
    """Write the movie of the tracks in a folder; return how many frames it has."""
    from accelsurf.track import PANELS, SavedTracks, open_sequence, write_track_movie
    from accelsurf.viewer import report_in

    given.check_files("run accelsurf track again")
    name = report_in(folder).path.name.removesuffix(report_name(""))
    saved = SavedTracks(folder, name, open_sequence(given.path, config))
    tracks = saved.track_set()
    write_track_movie(tracks, target, PANELS if saved.has_predictions else ("corrected",))
    return len(tracks.rows)


def _has_results(source: Path) -> bool:
    """Test if a path is meant as a folder with results: a folder that is no image, or one with a report."""
    if not source.is_dir():
        return False
    try:
        return any(source.glob("*_report.json")) or not format_of(source).name
    except InputError:  # no image
        return True


def _source(
    source: Path, settings: Any, config: Path | None
) -> tuple[GivenImage, RunConfig | TrackConfig]:
    """Image and settings of the run; those in the report if the source is a folder of results, else as given."""
    from accelsurf.viewer import run_of_folder

    if source.is_dir() and not any(source.glob("*_report.json")):
        refuse_unfinished(source)
    if not _has_results(source):
        made = run_config(settings, config)
        return GivenImage(source, made.reading), made
    given = given_options(settings)
    if given or config is not None:
        name = "config" if config is not None else next(iter(given)).replace("_", "-")
        raise UsageError(
            f"--{name} was given for a folder of results, whose report has the settings",
            "leave it out, or give the image instead of the folder",
        )
    return run_of_folder(source)


def _draw(
    run: Run, scene: Scene, target: Path, movie: MovieSettings | None, watcher: Watcher
) -> str:
    """Run to the end; write the movie, or without its settings a picture of the last step; describe the file."""
    from accelsurf.output import write_movie, write_png
    from accelsurf.viewer import last_picture, movie_pictures

    if movie is None:
        write_png(target, last_picture(run, scene, watcher.on_step))
        return "picture"
    count = write_movie(
        target, movie_pictures(run, scene, movie, watcher.on_step), movie.size, movie.fps
    )
    return f"{count} frames, {count / movie.fps:.1f} s"


def _ending(stop: Stop, has_ids: bool) -> str:
    """Say how a run ended."""
    if has_ids:
        return f"{stop.message}; up to {stop.steps} steps"
    return f"{stop.reason} after {stop.steps} steps ({stop.message})"


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise UsageError(
            f"size: {shown(text)} was given, expected WIDTHxHEIGHT in pixels", "as in 1280x720"
        ) from None
    return width, height
