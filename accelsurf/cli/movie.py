"""``accelsurf movie``: a movie, or one picture, of a run."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from accelsurf.cli import INTERRUPTED
from accelsurf.cli.options import FILES, Display, Output, Overwrite, RunSettings, required, run_config
from accelsurf.errors import UsageError

FILM = Group("Movie", sort_key=0)


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """What the pictures show, and how many there are."""

    color: Annotated[Literal["plain", "speed", "force", "density"], Parameter(group=FILM)] = "plain"
    """Colour of the surface: plain, or by outward speed, force or density."""

    theme: Annotated[Literal["dark", "light"], Parameter(group=FILM)] = "dark"
    """dark or light."""

    every: Annotated[int, Parameter(group=FILM)] = 1
    """A frame for each so many steps."""

    fps: Annotated[float, Parameter(group=FILM)] = 15.0
    """Frames per second."""

    size: Annotated[str, Parameter(group=FILM)] = "1280x720"
    """Width and height, pixels."""

    view: Annotated[
        Literal["corner", "front", "back", "left", "right", "top", "bottom"], Parameter(group=FILM)
    ] = "corner"
    """Where the camera looks from at first."""

    orbit: Annotated[float, Parameter(group=FILM)] = 12.0
    """Degrees that the camera turns per second of movie; 0 stands still."""

    hold: Annotated[float, Parameter(group=FILM)] = 2.0
    """Seconds that the last frame is shown longer."""

    volume: Annotated[bool, Parameter(negative=(), show_default=False, group=FILM)] = False
    """Show the image in 3D, translucent."""

    planes: Annotated[bool, Parameter(negative=(), show_default=False, group=FILM)] = False
    """Show the three slices in 3D."""


def movie(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
    *,
    output: Output = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    preview: Annotated[bool, Parameter(negative=(), show_default=False, group=FILM)] = False,
    look: Look | None = None,
    settings: RunSettings | None = None,  # type: ignore[valid-type]
    display: Display | None = None,
) -> int:
    """Make a movie of a run, without a screen.

    Runs as accelsurf segment does, with the same options and the same result, and draws while it goes. Of a folder
    with the results of a run, that run is repeated with the settings in its report.

    Parameters
    ----------
    input
        The image, or the folder of a run's results.
    output
        The movie: .mp4, .gif or .webp; with --preview .png.
    config
        TOML file with settings; options given here beat it.
    reference
        Label map on the image's grid to show, with Dice.
    overwrite
        Replace the movie if it exists.
    preview
        One PNG of the last frame, no movie.
    """
    from accelsurf import io
    from accelsurf.cli.progress import Watcher
    from accelsurf.io import channels
    from accelsurf.report.outputs import refuse_existing
    from accelsurf.segmentation.run import Run
    from accelsurf.viewer.frontends import movie_file as films
    from accelsurf.viewer.scene.headless import require_graphics
    from accelsurf.viewer.scene.scene import Scene

    look, display = look or Look(), display or Display()
    source, target = required(input, "INPUT"), required(output, "-o FILE, the movie,")
    film = films.Film(look.every, look.fps, look.orbit, look.hold, _size(look.size))
    if preview and target.suffix.lower() != ".png":
        raise UsageError(f"{target.name}: {target.suffix or 'no suffix'} was given, expected .png with --preview")
    if not preview and target.suffix.lower() == ".png":
        raise UsageError(f"{target.name}: .png was given, expected {', '.join(films.FORMATS)}", "or add --preview")
    if not preview:
        films.check_target(target, film.size)
    if source.is_dir():
        given = [f.name for f in fields(settings) if getattr(settings, f.name) is not None] if settings else []
        if given or config is not None:
            name = "config" if config is not None else given[0].replace("_", "-")
            raise UsageError(f"--{name} was given for a folder of results, whose report has the settings",
                             "leave it out, or give the image instead of the folder")
        image, run_settings = films.run_of_folder(source)
    else:
        image, run_settings = source, run_config(settings, config)
    refuse_existing({"movie": target}, overwrite)
    require_graphics()
    volume, *more = channels.read(image)
    scene = Scene(
        volume, theme=look.theme, reference=None if reference is None else io.read_labels(reference), size=film.size
    )
    scene.color_by(look.color)
    scene.look_from(look.view)
    scene.show_volume(look.volume)
    scene.show_planes(look.planes)
    watcher = Watcher(display)
    try:
        with watcher.watch(image.name, run_settings.max_steps):
            run = Run(volume, run_settings, None, more)
            if preview:
                films.run_to_last(run, scene, watcher.on_step)
                scene.screenshot(target)
                count = 1
            else:
                count = films.write(target, films.pictures(run, scene, film, watcher.on_step), film)
    finally:
        scene.close()
    if not display.quiet:
        stop = run.stop
        assert stop is not None
        what = "picture" if preview else f"{count} frames, {count / film.fps:.1f} s"
        print(f"{image.name}: {stop.reason} after {stop.steps} steps ({stop.message})\n  {what}  {target.absolute()}")
    return INTERRUPTED if watcher.interrupted else 0


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise UsageError(f"size: {text} was given, expected WIDTHxHEIGHT in pixels, as 1280x720") from None
    return width, height
