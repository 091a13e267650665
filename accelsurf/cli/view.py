"""``accelsurf view``: watch a segmentation run, and steer it.

The image is read in a thread, while window or page load.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from accelsurf.cases import Interrupts
from accelsurf.cli.options import (
    FILES,
    SHOW,
    File,
    InputFile,
    Output,
    Overwrite,
    Switch,
    run_config,
    settings_class,
)
from accelsurf.cli.track_options import SequenceSettings, track_config
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.viewer import ImageToOpen, ImageWithSession, OpenedImage, Opening, ViewerSettings

Settings = settings_class("Settings")


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
    asked: ImageToOpen | None = None
    waiting: list[Callable[[], OpenedImage]] = []

    def start() -> None:
        if asked is not None:
            waiting.append(asked.start_reading())

    with loading():
        if input is not None:
            from accelsurf.viewer import ImageToOpen

            asked = ImageToOpen(input, made, reference, tracks, times).of_result()
            made, tracks, times = asked.config, asked.tracks, asked.times
        _check_given(input, reference, tracks, times)
        page = front_end(page, start)
    first = waiting[0]() if waiting else None
    with ExitStack() as stack:
        opening = _opening(made, viewer.recent, page)
        from accelsurf.viewer import ImageWithSession, ViewerSettings

        settings = ViewerSettings(output, viewer.theme, overwrite, viewer.keep)
        session = None
        if first is not None:
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
    from accelsurf.viewer import Opening, RecentFiles, ServedFolder, recent_file

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
    from accelsurf.viewer import Opening  # noqa: F401 (with it the libraries)


def _load_window() -> None:
    """Load Qt, which may be done only where it can open a window."""
    from accelsurf.viewer import MainWindow  # noqa: F401 (with it Qt)


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
    from accelsurf.viewer import (
        INSTALL_WINDOW,
        has_page_packages,
        lacks_window_packages,
        require_display,
        require_graphics,
    )

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
        lack = lacks_window_packages()
        if not lack or not has_page_packages():
            require_display(meanwhile)
            _load_window()
            return page
        print(
            f"note: {lack} ({INSTALL_WINDOW}); a page in the browser opens instead",
            file=sys.stderr,
        )
    elif not has_page_packages():
        raise UsageError("browser: trame is not installed", INSTALL_WINDOW)
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
    from accelsurf.viewer import MainWindow, application

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

    from accelsurf.viewer import LOCAL, serve

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
