"""``accelsurf view``: watch a segmentation run, and steer it.

The image is read in a thread, while window or page load.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from accelsurf.cli.options import (
    FILES,
    SHOW,
    File,
    InputFile,
    Output,
    Overwrite,
    Switch,
    given_options,
    run_config,
    settings_class,
)
from accelsurf.cli.track_options import SequenceSettings, track_config
from accelsurf.errors import InputError, UsageError
from accelsurf.settings.registry import load
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.image.volume import Volume
    from accelsurf.output.given_image import GivenImage
    from accelsurf.viewer.actions.opening import Opening, ViewerSettings
    from accelsurf.viewer.core.opening import ImageWithSession, OpenedImage

Settings = settings_class("Settings")


@dataclass(frozen=True)
class FirstImage:
    """The image that is opened first, as the command line names it.

    Attributes
    ----------
    source : Path
        A file or folder.
    config : RunConfig
        Settings of its run; among them how it is read.
    reference : Path or None
        Labels to compare with.
    tracks : Path or None
        Folder of its tracks, from ``accelsurf track``.
    times : TrackConfig
        How a sequence is read.
    given : GivenImage or None
        The image of a finished run: another one is refused.
    """

    source: Path
    config: RunConfig
    reference: Path | None
    tracks: Path | None
    times: TrackConfig
    given: GivenImage | None = None

    def start_reading(self) -> Callable[[], OpenedImage]:
        """Begin to read; return a function that waits for the image.

        A single image is read in a thread. Of a sequence headers and one frame are read, when it is waited for.

        Raises
        ------
        InputError
            When the header cannot be read; other errors are raised by the returned function.
        UsageError
            When a time between frames was given for a single image.
        """
        from accelsurf.io import channels, headers
        from accelsurf.io.files import naming
        from accelsurf.io.sequences import reading as sequences
        from accelsurf.viewer.core.command_queue import in_background

        reading = self.config.reading
        if (
            self.tracks is not None
            or self.times.frames_from_slices
            or sequences.is_sequence(self.source, reading)
        ):
            return self._sequence
        if self.times.frame_time is not None:
            raise UsageError(
                "frame_time: it was given for a single image",
                "leave it out, or add --frames-from-slices",
            )
        with naming(self.source):
            form = headers.format_of(self.source)
        # Loaded here: two threads that load the same library may see it half loaded.
        for work in (form.parse, form.read, form.read_channels):
            if work is not None:
                load(work)
        volumes = in_background(
            lambda: channels.read_channels(self.source, reading), "accelsurf reading"
        )
        return partial(self._image, volumes)

    def _image(self, volumes: Future[list[Volume]]) -> OpenedImage:
        from accelsurf.io import on_grid, split_name
        from accelsurf.viewer.core.opening import OpenedImage

        truth = self._truth()
        volume, *more = volumes.result()
        if self.given is not None:
            self.given.check([volume, *more], "run accelsurf segment again")
        truth = None if truth is None else on_grid(truth, volume.geometry)
        return OpenedImage(
            volume, self.config, split_name(self.source)[0], self.source, tuple(more), truth
        )

    def _sequence(self) -> OpenedImage:
        from accelsurf.viewer.core.opening import read_tracked

        truth, times = self._truth(), self.times
        found = read_tracked(
            self.source, self.config, self.tracks, times.frame_time, times.frames_from_slices
        )
        return replace(found, reference=truth)

    def _truth(self) -> Volume | None:
        from accelsurf.io import read_labels

        return None if self.reference is None else read_labels(self.reference)


@contextmanager
def loading() -> Iterator[None]:
    """Let Python not look for garbage while many modules are loaded, nor afterwards among their objects.

    The searches are a sixth of the time of loading. One over all that was loaded, of which nothing is garbage, takes as
    long as the window's first picture.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        # Less than the program's: a window is open for hours, and images that it has shown may be in a cycle.
        gc.set_threshold(min(gc.get_threshold()[0], 50_000))
        if was_enabled:
            gc.enable()


@Parameter(name="*")
@dataclass(frozen=True)
class PageOptions:
    """Options of the page."""

    browser: Switch = False
    """Open a page in the browser, served from this machine, instead of a window; needs no screen. Ctrl-C ends it."""

    host: Annotated[
        str | None, Parameter(group=SHOW, show_default="127.0.0.1, this machine alone")
    ] = None
    """With --browser: address to listen on, for browsers on other machines. Nothing is encrypted."""

    port: Annotated[int | None, Parameter(group=SHOW, show_default="a free one")] = None
    """With --browser: port to listen on."""

    open_page: Annotated[bool, Parameter(name="--open", negative="--no-open", group=SHOW)] = True
    """With --browser: open the page."""

    folder: Annotated[Path | None, Parameter(group=FILES, show_default="the present folder")] = None
    """With --browser: images in this folder, and in those in it, can be opened from the page; none elsewhere."""


@Parameter(name="*")
@dataclass(frozen=True)
class ViewerOptions:
    """Options of window and page."""

    theme: Annotated[Literal["dark", "light"], Parameter(group=SHOW)] = "dark"
    """Colours of the window or page: dark or light."""

    keep: Annotated[float, Parameter(group=SHOW)] = 512.0
    """Memory for stored steps to which you can return, MB."""

    recent: Annotated[bool, Parameter(group=SHOW)] = True
    """List the images that were opened last, and remember those that are opened now."""


def view(
    input: InputFile = None,
    *,
    output: Output = None,
    config: File = None,
    reference: File = None,
    tracks: File = None,
    overwrite: Overwrite = False,
    page: PageOptions | None = None,
    viewer: ViewerOptions | None = None,
    frames: SequenceSettings | None = None,  # type: ignore[valid-type]
    settings: Settings | None = None,  # type: ignore[valid-type]
) -> int:
    """Watch and steer a segmentation in a window, or in a browser.

    Without an image a start page opens: recent files, phantoms, a dialog to open a file or folder; an image can also be
    dropped on it. Another image, or a reference, can be opened in the same way at any time.

    Place a start, run, change settings while it runs, go back and forward, add and remove parts, save. The files are
    those of accelsurf segment; with NAME_run.toml segment makes the same bytes. F1 in the window shows keys and
    mouse.

    In place of an image the folder of a result may be given, or its report: the run is made again to its end, and goes
    on from there. Of a folder of accelsurf track the sequence opens with its tracks.

    The window needs a screen and more packages: pip install "accelsurf[viewer]". Runs on one level unless --levels
    asks for more. With --objects each object has a colour of its own, and a ball that is added or removed changes the
    nearest one, or the one that you choose.

    Parameters
    ----------
    input
        The image, or the folder of a result; without it the start page opens.
    output
        Folder to save in; without it the window asks for one. Further images are saved in folders in it.
    config
        TOML file with settings, such as NAME_run.toml of an earlier session; options given here override it.
    reference
        Label map of the true object, on the same grid: also drawn, with the Dice coefficient.
    tracks
        Folder of accelsurf track: objects are drawn in each frame, and predictions if it had --also surfaces.
    overwrite
        Replace files in the folder that this session has not written.
    """
    made = run_config(settings, config)
    page = page or PageOptions()
    viewer = viewer or ViewerOptions()
    times = track_config(frames, None, None)
    finished = None if input is None else finished_run(input)
    image = None if finished is None else finished[0]
    if input is not None and finished is not None:
        folder, (given, before) = input, finished
        input = given.path
        if isinstance(before, TrackConfig):
            tracks = tracks or (folder if folder.is_dir() else folder.parent)
            times, before = before.replace(**given_options(frames)), before.run
        made = before.replace(**{key: getattr(made, key) for key in made.model_fields_set})
    _check_given(input, reference, tracks, times)
    waiting: list[Callable[[], OpenedImage]] = []

    def start() -> None:
        if input is not None:
            first = FirstImage(input, made, reference, tracks, times, image)
            waiting.append(first.start_reading())

    with loading():
        page = front_end(page, start)
    first = waiting[0]() if waiting else None
    with ExitStack() as stack:
        opening = _opening(made, viewer.recent, page)
        from accelsurf.viewer.actions.opening import ViewerSettings
        from accelsurf.viewer.core.opening import ImageWithSession

        settings = ViewerSettings(output, viewer.theme, overwrite, viewer.keep)
        session = None
        if first is not None:
            first = replace(first, is_result=finished is not None and tracks is None)
            session = first.session(viewer.keep, begin=page.browser)
            stack.callback(session.close, 0.0)  # window and page wait for it, if it may take time
            if page.browser:
                session.ready.result()
        opened = None if first is None or session is None else ImageWithSession(first, session)
        if page.browser:
            _serve(opening, opened, settings, page)
        else:
            open_window(opening, opened, settings)
    return 0


def finished_run(path: Path) -> tuple[GivenImage, RunConfig | TrackConfig] | None:
    """Return image and settings of the result that a folder or a report has; None for an image.

    Raises
    ------
    InputError
        When there are several results, or the image is not there.
    """
    from accelsurf.io.file_set import refuse_unfinished
    from accelsurf.output.given_image import GivenImage, settings_of
    from accelsurf.output.reports import Report

    known = (
        sorted(path.glob("*_report.json"))
        if path.is_dir()
        else [path]
        if path.suffix == ".json"
        else []
    )
    if path.is_dir() and not known:
        refuse_unfinished(path)
    found = [Report(each) for each in known]
    reports = {each.path: each.document for each in found if each.document and not each.is_failure}
    if not reports:
        return None
    if len(reports) > 1:
        raise InputError(
            f"{path}: there are several results: {', '.join(map(str, reports))}", "give one of them"
        )
    ((report, document),) = reports.items()
    run = report.with_name(f"{report.name.removesuffix('_report.json')}_run.toml")
    hint = f"give where it is now: accelsurf view IMAGE --config {run}"
    given = GivenImage.of_report(document, report).found(None, hint)
    return given, settings_of(document, report)


def _check_given(
    image: Path | None, reference: Path | None, tracks: Path | None, times: TrackConfig
) -> None:
    """Refuse inputs that lack their image, or exclude each other."""
    if image is None and (times.frame_time is not None or times.frames_from_slices):
        key = "frames_from_slices" if times.frames_from_slices else "frame_time"
        raise UsageError(f"{key}: it was given without a sequence", "give the sequence, too")
    if image is None and reference is not None:
        raise UsageError("reference: it was given without an image", "give the image, too")
    if tracks is not None and image is None:
        raise UsageError("tracks: they were given without a sequence", "give the sequence, too")
    if tracks is not None and reference is not None:
        raise UsageError("reference and tracks exclude each other", "leave one of them out")


def _opening(config: RunConfig, recent: bool, page: PageOptions) -> Opening:
    """Return the opener of images: for a page only of its folder, and for other machines without recent files."""
    from accelsurf.viewer.actions.opening import Opening
    from accelsurf.viewer.core.opening import ServedFolder
    from accelsurf.viewer.core.recent_files import RecentFiles, recent_file

    listed = RecentFiles(recent_file() if recent and _is_local(page) else None)
    if not page.browser:
        return Opening(config, listed)
    folder = page.folder or Path()
    if not folder.is_dir():
        raise UsageError(
            f"--folder: {folder} was given, expected a folder", "give the folder of your images"
        )
    return Opening(config, listed, ServedFolder(folder))


def _is_local(page: PageOptions) -> bool:
    """Return True if this machine alone is served."""
    return page.host in (None, "127.0.0.1", "localhost")


def load_viewer() -> None:
    """Load the libraries with which window and page draw; it takes seconds."""
    import accelsurf.viewer.actions.opening  # noqa: F401


def _load_window() -> None:
    """Load Qt, which may be done only where it can open a window."""
    import accelsurf.viewer.window.main_window  # noqa: F401


def front_end(page: PageOptions, begin: Callable[[], None]) -> PageOptions:
    """Check that the window, or else the page, can be shown here.

    Where the packages of the window are missing, but not the page's, the page opens.

    Parameters
    ----------
    page : PageOptions
    begin : callable
        Begins to read the image to show, when nothing that is known at once is in the way. Then the modules that draw
        it are loaded too, while another process tries whether they can.

    Raises
    ------
    UsageError
        When options of the page are given for a window.
    GraphicsError
        When a screen, driver or package is missing.
    """
    from accelsurf.viewer.scene.headless import require_graphics
    from accelsurf.viewer.window import display

    def meanwhile() -> None:
        begin()
        load_viewer()

    if not page.browser:
        asked = {"--host": page.host, "--port": page.port, "--no-open": not page.open_page or None}
        for name, given in {**asked, "--folder": page.folder}.items():
            if given is not None:
                raise UsageError(
                    f"{name} was given for a window", "it has an effect with --browser only"
                )
        lack = display.lacks_window_packages()
        if not lack or not display.has_page_packages():
            display.require_display(meanwhile)
            _load_window()
            return page
        print(
            f"note: {lack} ({display.INSTALL}); a page in the browser opens instead",
            file=sys.stderr,
        )
    elif not display.has_page_packages():
        raise UsageError("browser: trame is not installed", display.INSTALL)
    meanwhile()
    require_graphics()
    return replace(page, browser=True)


def open_window(opening: Opening, first: ImageWithSession | None, settings: ViewerSettings) -> None:
    """Open a window until the user closes it, or the run of the first image cannot be prepared.

    Raises
    ------
    AccelsurfError
        With the fault in the settings of that run.
    """
    from accelsurf.viewer.window.desktop import application
    from accelsurf.viewer.window.main_window import MainWindow

    app = application()
    window = MainWindow(opening, settings)
    with ending(opening, window.end_soon):
        if first is not None:
            window.open(*first, close_if_it_fails=True)
        window.show()
        app.exec()
    if first is not None and first.session.ready.done():
        first.session.ready.result()


@contextmanager
def ending(
    opening: Opening, listener: Callable[[], None], usual: Sequence[int] = ()
) -> Iterator[None]:
    """Let window or page end itself when a signal comes, see `Interrupts.calling`; then end its sessions, and say
    the work that is kept.
    """
    from accelsurf.cases.interrupts import Interrupts

    def hear() -> None:
        opening.hurry()
        listener()

    interrupts = Interrupts.current()
    with interrupts.calling(hear, usual):
        yield
    interrupts.note(opening.last_words)
    opening.close()
    interrupts.note(opening.last_words)


def _serve(
    opening: Opening, first: ImageWithSession | None, settings: ViewerSettings, page: PageOptions
) -> None:
    """Serve the page until Ctrl-C, which is the documented way to end it."""
    import signal
    import threading
    import webbrowser

    from accelsurf.viewer.page.guard import LOCAL
    from accelsurf.viewer.page.page import serve

    def show_address(address: str) -> None:
        print(f"{address}\nCtrl-C ends it", flush=True)
        if page.open_page:
            webbrowser.open(address)

    if not _is_local(page):
        print(
            f"warning: --host {page.host}: everyone with access to this machine and the address can change the run "
            "and download files; nothing is encrypted",
            file=sys.stderr,
        )
    ends = threading.Event()
    with ending(opening, ends.set, [signal.SIGINT]):
        serve(
            opening, first, settings, page.host or LOCAL, page.port or 0, show_address, ends.is_set
        )
    if ends.is_set() and opening.is_stored:
        print(f"note: {opening.last_words}", file=sys.stderr)
