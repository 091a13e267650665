"""``accelsurf view``: watch a segmentation run, and steer it."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, InputFile, Overwrite, Settings, run_config
from accelsurf.cli.track_options import SequenceSettings, track_config
from accelsurf.errors import UsageError
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.settings.track_config import TrackConfig
    from accelsurf.viewer.core.opening import OpenedImage
    from accelsurf.viewer.core.session import Session
    from accelsurf.viewer.workplace.opening import Opening

#: Settings that say how a sequence is read.
_OF_READING = tuple(one.name for one in fields(ReadOptions) if one.name not in ("time_index", "channels_from_time"))


@Parameter(name="*")
@dataclass(frozen=True)
class PageOptions:
    """Where the page is served."""

    browser: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False
    """Open a page in the browser, served from this machine, instead of a window; needs no screen. Ctrl-C ends it."""

    host: Annotated[str | None, Parameter(group=SHOW, show_default="127.0.0.1, this machine alone")] = None
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
    """How window and page look, and what they remember."""

    theme: Annotated[Literal["dark", "light"], Parameter(group=SHOW)] = "dark"
    """Colours of the window or page: dark or light."""

    keep: Annotated[float, Parameter(group=SHOW)] = 512.0
    """Memory for stored steps to which you can return, MB."""

    recent: Annotated[bool, Parameter(group=SHOW)] = True
    """List the images that were opened last, and remember those that are opened now."""


def view(
    input: InputFile = None,
    *,
    result: Annotated[Path | None, Parameter(group=FILES)] = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    tracks: Annotated[Path | None, Parameter(group=FILES)] = None,
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
    those of accelsurf segment, and run.toml, with which segment makes the same bytes. F1 in the window shows keys and
    mouse.

    The window needs a screen and more packages: pip install "accelsurf[viewer]". Runs on one level unless --levels
    asks for more. With --objects each object has a colour of its own, and a ball that is added or removed changes the
    nearest one, or the one that you choose.

    Parameters
    ----------
    input
        The image; without it the start page opens.
    result
        Folder to save in; without it the window asks for one. Further images are saved in folders in it.
    config
        TOML file with settings, such as run.toml of an earlier session; options given here override it.
    reference
        Label map of the true object, on the same grid: also drawn, with the Dice coefficient.
    tracks
        Folder of accelsurf track: objects are drawn in each frame, and predictions if it had --also surfaces.
    overwrite
        Replace files in the folder that this session has not written.
    """
    made, page, viewer = run_config(settings, config), page or PageOptions(), viewer or ViewerOptions()
    times = track_config(frames, None, None)
    _check_given(input, reference, tracks, times)
    page = front_end(page)
    first = None if input is None else _read(input, made, reference, tracks, times)
    return _show(first, made, page, viewer, result, overwrite)


def show_tracks(source: Path, tracks: Path, config: TrackConfig, page: PageOptions) -> int:
    """Open a sequence with what ``accelsurf track`` has found in it, until the user ends it.

    Parameters
    ----------
    source : Path
        The sequence.
    tracks : Path
        Folder of the tracking's files.
    config : TrackConfig
        Of the tracking: how the sequence is read, and the frame that is shown first.
    page : PageOptions
        From `front_end`.
    """
    run = config.run
    made = RunConfig(time_index=config.frame, **{key: getattr(run, key) for key in _OF_READING})
    return _show(_read(source, made, None, tracks, config), made, page, ViewerOptions(), None, False)


def _show(
    first: OpenedImage | None, made: RunConfig, page: PageOptions, viewer: ViewerOptions, result: Path | None,
    overwrite: bool,
) -> int:
    """Open window or page, with an image or the start page, until the user ends it."""
    from accelsurf.cli.interrupts import default_handling

    # Ctrl-C is the documented way to end a page.
    with ExitStack() as stack:
        stack.enter_context(default_handling())
        opening = _opening(made, viewer.recent, page)
        session = None
        if first is not None:
            session = stack.enter_context(first.session(viewer.keep))
            session.ready.result()
        opened = None if first is None or session is None else (first, session)
        if page.browser:
            _serve(opening, opened, result, overwrite, viewer, page)
        else:
            _open_window(opening, opened, result, overwrite, viewer)
    return 0


def _check_given(image: Path | None, reference: Path | None, tracks: Path | None, times: TrackConfig) -> None:
    """Refuse what lacks its image, or does not go together."""
    if image is None and (times.frame_time is not None or times.frames_from_slices):
        key = "frames_from_slices" if times.frames_from_slices else "frame_time"
        raise UsageError(f"{key}: it was given without a sequence", "give the sequence, too")
    if image is None and reference is not None:
        raise UsageError("reference: it was given without an image", "give the image, too")
    if tracks is not None and image is None:
        raise UsageError("tracks: they were given without a sequence", "give the sequence, too")
    if tracks is not None and reference is not None:
        raise UsageError("reference: it was given with tracks", "leave one of both out")


def _read(
    source: Path, config: RunConfig, reference: Path | None, tracks: Path | None, times: TrackConfig
) -> OpenedImage:
    """Read the image, as the other commands do, or a sequence as ``times`` say, and labels to compare with."""
    from accelsurf import io
    from accelsurf.io import channels
    from accelsurf.viewer.core.opening import OpenedImage, is_sequence, read_tracked

    truth = None if reference is None else io.read_labels(reference)
    if tracks is not None or times.frames_from_slices or is_sequence(source, config):
        found = read_tracked(source, config, tracks, times.frame_time, times.frames_from_slices)
        return replace(found, reference=truth)
    if times.frame_time is not None:
        raise UsageError("frame_time: it was given for a single image", "leave it out, or add --frames-from-slices")
    volume, *more = channels.read(source, config.reading)
    return OpenedImage(volume, config, io.split_name(source)[0], source, tuple(more), truth)


def _opening(config: RunConfig, recent: bool, page: PageOptions) -> Opening:
    """What opens images: for a page only those in its folder, and for other machines without what was opened last."""
    from accelsurf.viewer.core.recent_files import RecentFiles, recent_file
    from accelsurf.viewer.core.served_folder import ServedFolder
    from accelsurf.viewer.workplace.opening import Opening

    listed = RecentFiles(recent_file() if recent and _is_local(page) else None)
    if not page.browser:
        return Opening(config, listed)
    folder = page.folder or Path()
    if not folder.is_dir():
        raise UsageError(f"--folder: {folder} was given, expected a folder", "give the folder of your images")
    return Opening(config, listed, ServedFolder(folder))


def _is_local(page: PageOptions) -> bool:
    """Whether this machine alone is served."""
    return page.host in (None, "127.0.0.1", "localhost")


def front_end(page: PageOptions) -> PageOptions:
    """Check that the window, or else the page, can be shown here, before the image is read.

    Where the packages of the window are missing, but not those of the page, the page opens.

    Raises
    ------
    UsageError
        When options of the page are given for a window.
    GraphicsError
        When a screen, driver or package is missing.
    """
    from accelsurf.viewer.frontends import display
    from accelsurf.viewer.scene.headless import require_graphics

    if not page.browser:
        asked = {"--host": page.host, "--port": page.port, "--no-open": not page.open_page or None}
        for name, given in {**asked, "--folder": page.folder}.items():
            if given is not None:
                raise UsageError(f"{name} was given for a window", "it has an effect with --browser only")
        lack = display.lacks_window_packages()
        if not lack or not display.has_page_packages():
            display.require_display()
            return page
        print(f"note: {lack} ({display.INSTALL}); a page in the browser opens instead", file=sys.stderr)
    elif not display.has_page_packages():
        raise UsageError("browser: trame is not installed", display.INSTALL)
    require_graphics()
    return replace(page, browser=True)


def _open_window(
    opening: Opening, first: tuple[OpenedImage, Session] | None, folder: Path | None, overwrite: bool,
    viewer: ViewerOptions,
) -> None:
    """Open a window until the user closes it."""
    from accelsurf.viewer.frontends.desktop import application
    from accelsurf.viewer.frontends.main_window import MainWindow

    app = application()
    window = MainWindow(opening, folder, viewer.theme, overwrite, viewer.keep)
    if first is not None:
        window.open(*first)
    window.show()
    app.exec()


def _serve(
    opening: Opening, first: tuple[OpenedImage, Session] | None, folder: Path | None, overwrite: bool,
    viewer: ViewerOptions, page: PageOptions,
) -> None:
    """Serve the page until Ctrl-C."""
    import webbrowser

    from accelsurf.viewer.frontends.browser import serve
    from accelsurf.viewer.frontends.page_guard import LOCAL

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
    host, port = page.host or LOCAL, page.port or 0
    serve(opening, first, folder, viewer.theme, overwrite, viewer.keep, host, port, show_address)
