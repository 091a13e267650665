"""``accelsurf view``: watch a segmentation run, and steer it."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, InputFile, Overwrite, Settings, required, run_config
from accelsurf.errors import UsageError

if TYPE_CHECKING:
    from accelsurf.grid.volume import Volume
    from accelsurf.viewer.core.session import Session


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


def view(
    input: InputFile = None,
    *,
    result: Annotated[Path | None, Parameter(group=FILES)] = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    page: PageOptions | None = None,
    theme: Annotated[Literal["dark", "light"], Parameter(group=SHOW)] = "dark",
    keep: Annotated[float, Parameter(group=SHOW)] = 512.0,
    settings: Settings | None = None,  # type: ignore[valid-type]
) -> int:
    """Watch and steer a segmentation in a window, or in a browser.

    Place a start, run, change settings while it runs, go back and forward, add and remove parts, save. The files are
    those of accelsurf segment, and run.toml, with which segment makes the same bytes. F1 in the window shows keys and
    mouse.

    The window needs a screen and more packages: pip install "accelsurf[viewer]". Runs on one level unless --levels
    asks for more. With --objects each object has a colour of its own, and a ball that is added or removed changes the
    nearest one, or the one that you choose.

    Parameters
    ----------
    input
        The image.
    result
        Folder to save in; without it the window asks for one.
    config
        TOML file with settings, such as run.toml of an earlier session; options given here override it.
    reference
        Label map of the true object, on the same grid: also drawn, with the Dice coefficient.
    overwrite
        Replace files in the folder that this session has not written.
    theme
        Colours of the window or page: dark or light.
    keep
        Memory for stored steps to which you can return, MB.
    """
    source, page = required(input, "INPUT"), page or PageOptions()
    made = run_config(settings, config)
    page = _front_end(page)
    from accelsurf import io
    from accelsurf.cli.interrupts import default_handling
    from accelsurf.io import channels

    volume, *more = channels.read(source, made.reading)
    truth = None if reference is None else io.read_labels(reference)
    from accelsurf.viewer.core.session import Session

    name = io.split_name(source)[0]
    opened = Session(volume, made, name=name, source=source, checkpoint_mb=keep, channels=more)
    with default_handling(), opened as session:  # Ctrl-C is the documented way to end a page
        session.ready.result()
        if page.browser:
            _serve(session, truth, result, theme, overwrite, page)
        else:
            _open_window(session, truth, result, theme, overwrite)
    return 0


def _front_end(page: PageOptions) -> PageOptions:
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
        for name, given in {"--host": page.host, "--port": page.port, "--no-open": not page.open_page or None}.items():
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
    session: Session, truth: Volume | None, folder: Path | None, theme: str, overwrite: bool
) -> None:
    """Open a window until the user closes it."""
    from accelsurf.viewer.frontends.desktop import Window, application

    app = application()
    window = Window(session, truth, folder, theme, overwrite)
    window.show()
    app.exec()


def _serve(
    session: Session, truth: Volume | None, folder: Path | None, theme: str, overwrite: bool, page: PageOptions
) -> None:
    """Serve the page until Ctrl-C."""
    import webbrowser

    from accelsurf.viewer.frontends.browser import serve
    from accelsurf.viewer.frontends.page_guard import LOCAL

    def show_address(address: str) -> None:
        print(f"{address}\nCtrl-C ends it", flush=True)
        if page.open_page:
            webbrowser.open(address)

    if page.host not in (None, LOCAL, "localhost"):
        print(
            f"warning: --host {page.host}: everyone with access to this machine and the address can change the run "
            "and download files; nothing is encrypted",
            file=sys.stderr,
        )
    serve(session, truth, folder, theme, overwrite, page.host or LOCAL, page.port or 0, show_address)
