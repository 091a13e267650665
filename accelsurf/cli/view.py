"""``accelsurf view``: a segmentation that a person watches and steers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from accelsurf.cli.options import FILES, SHOW, Overwrite, Settings, required, run_config
from accelsurf.errors import UsageError


def view(
    input: Annotated[Path | None, Parameter(name=("--input", "-i"), group=FILES)] = None,
    *,
    result: Annotated[Path | None, Parameter(group=FILES)] = None,
    config: Annotated[Path | None, Parameter(group=FILES)] = None,
    reference: Annotated[Path | None, Parameter(group=FILES)] = None,
    overwrite: Overwrite = False,
    browser: Annotated[bool, Parameter(negative=(), show_default=False, group=SHOW)] = False,
    host: Annotated[str | None, Parameter(group=SHOW, show_default="127.0.0.1, this machine alone")] = None,
    port: Annotated[int | None, Parameter(group=SHOW, show_default="a free one")] = None,
    open_page: Annotated[bool, Parameter(name="--open", negative="--no-open", group=SHOW)] = True,
    theme: Annotated[Literal["dark", "light"], Parameter(group=SHOW)] = "dark",
    keep: Annotated[float, Parameter(group=SHOW)] = 512.0,
    settings: Settings | None = None,  # type: ignore[valid-type]
) -> int:
    """Watch and steer a segmentation in a window, or in a browser.

    Place a start, run, change settings while it runs, go back, push the surface, save. What is saved is what segment
    writes, and run.toml, with which segment makes the same bytes. F1 in the window shows keys and mouse.

    Needs a screen and the packages of the viewer: pip install "accelsurf[viewer]". Runs on one level unless --levels
    asks for more.

    Parameters
    ----------
    input
        The image: .nii, .nii.gz, .nrrd, .mha, .mhd, .png or .tif.
    result
        Folder to save in; asked for when it is needed otherwise.
    config
        TOML file with settings, as run.toml of an earlier session; options given here beat it.
    reference
        Label map of the true object, on the same grid: drawn too, with Dice.
    overwrite
        Replace files in the folder that this session has not written.
    browser
        In a page of a browser, served from this machine; no screen is needed here. Ctrl-C ends it.
    host
        With --browser: address to listen on, for pages on other machines. Nothing is encrypted.
    port
        With --browser: port to listen on.
    open_page
        With --browser: open the page.
    theme
        Dark or light.
    keep
        Memory for the steps that can be gone back to, MB.
    """
    source = required(input, "INPUT")
    made = run_config(settings, config)
    if not browser:
        for name, value in {"--host": host, "--port": port, "--no-open": None if open_page else True}.items():
            if value is not None:
                raise UsageError(f"{name} was given for a window", "it means something with --browser only")
    from accelsurf import io
    from accelsurf.io import channels

    if browser:
        from accelsurf.viewer.scene.headless import require_graphics

        require_graphics()
    else:
        from accelsurf.viewer.frontends.display import require_display

        require_display()
    volume, *more = channels.read(source)
    truth = None if reference is None else io.read_labels(reference)
    from accelsurf.viewer.core.session import Session

    with Session(volume, made, name=io.split_name(source)[0], source=source, kept_mb=keep, channels=more) as session:
        if browser:
            from accelsurf.viewer.frontends.browser import LOCAL, serve

            session.ready.result()
            if host not in (None, LOCAL, "localhost"):
                print(_OPEN_TO_OTHERS.format(host), file=sys.stderr)
            serve(session, truth, result, theme, overwrite, host or LOCAL, port or 0, lambda at: _tell(at, open_page))
        else:
            from accelsurf.viewer.frontends.desktop import show

            session.ready.result()
            show(session, truth, result, theme, overwrite)
    return 0


_OPEN_TO_OTHERS = (
    "warning: --host {}: whoever reaches this machine and has the address can change the run and download files; "
    "nothing is encrypted"
)


def _tell(address: str, open_page: bool) -> None:
    """Say where the page is, and open it."""
    import webbrowser

    print(f"{address}\nCtrl-C ends it", flush=True)
    if open_page:
        webbrowser.open(address)
