"""Serves the page until the user ends it."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path

from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.session import CHECKPOINT_MB, Session
from accelsurf.viewer.frontends.page import POLL_SECONDS, Page
from accelsurf.viewer.frontends.page_guard import LOCAL
from accelsurf.viewer.workplace.opening import Opening


def serve(
    opening: Opening,
    first: tuple[OpenedImage, Session] | None,
    folder: Path | None,
    theme: str,
    overwrite: bool = False,
    checkpoint_mb: float = CHECKPOINT_MB,
    host: str = LOCAL,
    port: int = 0,
    on_ready: Callable[[str], None] | None = None,
) -> None:
    """Serve the page until Ctrl-C.

    Parameters
    ----------
    opening : Opening
    first : (OpenedImage, Session) or None
        The image that is open at first; None for the start page.
    folder : Path or None
        Where files are saved; None: a folder that is deleted at the end, from which they can be downloaded.
    theme : str
        "dark" or "light".
    overwrite : bool, optional
        Replace files there that a session has not written.
    checkpoint_mb : float, optional
        Memory for stored steps, MB.
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
    with contextlib.ExitStack() as stack:
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="accelsurf-")))
        uploads = temporary / "uploads"
        uploads.mkdir()
        page = Page(opening, folder or temporary, uploads, host, port, overwrite, theme, checkpoint_mb)
        stack.callback(page.close)
        if first is not None:
            page.open(*first)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve(page, on_ready))


async def _serve(page: Page, on_ready: Callable[[str], None] | None) -> None:
    serving = asyncio.ensure_future(page.serve())
    while not page.address and not serving.done():
        await asyncio.sleep(POLL_SECONDS)
    if page.address and on_ready is not None:
        on_ready(page.address)
    await serving
