"""Serves a session as a page until the user ends it."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path

from accelsurf.grid.grey_window import parse_window
from accelsurf.grid.volume import Volume
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.frontends.page import POLL_SECONDS, Page
from accelsurf.viewer.frontends.page_guard import LOCAL
from accelsurf.viewer.scene.scene import Scene


def serve(
    session: Session,
    reference: Volume | None,
    folder: Path | None,
    theme: str,
    overwrite: bool = False,
    host: str = LOCAL,
    port: int = 0,
    on_ready: Callable[[str], None] | None = None,
) -> None:
    """Serve a session in a page until Ctrl-C.

    Parameters
    ----------
    session : Session
    reference : Volume or None
        Labels to compare with.
    folder : Path or None
        Where files are saved; None: a folder that is deleted at the end, from which they can be downloaded.
    theme : str
        "dark" or "light".
    overwrite : bool, optional
        Replace files there that this session has not written.
    host, port : str, int, optional
        As of `Page`.
    on_ready : callable, optional
        Called with the address, once the page is served.

    Raises
    ------
    UsageError
        When trame is not installed.
    OutputError
        When the server cannot listen on the address.
    GraphicsError
        When nothing can be drawn here.
    """
    window = parse_window(session.status.settings.window)
    scene = Scene(session.volume, theme=theme, reference=reference, window=window)
    with contextlib.ExitStack() as stack:
        stack.callback(scene.close)
        home = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="accelsurf-")))
        page = Page(session, scene, home, host, port, overwrite)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve(page, on_ready))


async def _serve(page: Page, on_ready: Callable[[str], None] | None) -> None:
    serving = asyncio.ensure_future(page.serve())
    while not page.address and not serving.done():
        await asyncio.sleep(POLL_SECONDS)
    if page.address and on_ready is not None:
        on_ready(page.address)
    await serving
