"""The scene in a page: a session steered from a browser on this machine, served by trame.

The page shows pictures of the same scene as the window, drawn here, and sends requests, which `requests` checks. It
loads nothing from elsewhere. Whoever has the token of the address can change the run; nobody else is answered.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import html
import io
import secrets
import socket
import sys
import time
from collections import deque
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from accelsurf.errors import OutputError, UsageError
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.frontends.display import INSTALL
from accelsurf.viewer.frontends.page_guard import LOCAL, PageGuard
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.workplace.files import FilesFeature
from accelsurf.viewer.workplace.help import help_rows
from accelsurf.viewer.workplace.mouse import MouseFeature
from accelsurf.viewer.workplace.quiet import Quiet
from accelsurf.viewer.workplace.workplace import Workplace

#: Seconds between looks at the session; `Session.next_view` bounds the pictures per second.
POLL_SECONDS = 0.02
#: Seconds until a page that shows nothing gets the next picture all the same.
PATIENCE = 2.0


class Page:
    """A session in a page.

    Parameters
    ----------
    session : Session
    scene : Scene
        Of the same image; drawn in the thread that serves.
    folder : Path
        Where files are saved, and downloaded from.
    host : str, optional
        Address to listen on; by default of this machine alone.
    port : int, optional
        0 takes a free one.
    overwrite : bool, optional
        Replace files in the folder that this session has not written.

    Attributes
    ----------
    workplace : Workplace
    token : str
        Whoever has it can change the run.
    address : str
        What to open, with the token; empty before the page is served.

    Raises
    ------
    UsageError
        When trame is not installed.
    """

    def __init__(
        self,
        session: Session,
        scene: Scene,
        folder: Path,
        host: str = LOCAL,
        port: int = 0,
        overwrite: bool = False,
    ) -> None:
        self.session, self.scene = session, scene
        self.workplace = Workplace(session, scene, folder, overwrite)
        self.token, self.address = secrets.token_hex(24), ""
        self._guard = PageGuard(host, self.token, self.workplace.feature(FilesFeature).files)
        self._host, self._port = host, port
        #: Seconds of the last pictures; the shortest counts: the first of a size takes long.
        self._drawing: deque[float] = deque([0.0], maxlen=3)
        self.quiet = Quiet(self.workplace)
        self._sent_at, self._is_shown = 0.0, True
        self._server = self._make_server()

    # -- the page -----------------------------------------------------------------------------------------

    def _make_server(self) -> Any:
        get_server, layout, style = _import_trame()
        server = get_server(f"accelsurf-{self.token[:8]}", client_type="vue3")
        tools = self.workplace.tools.values()
        server.state.update(self._state() | {
            "trame__title": "accelsurf", "picture": "", "title": self.scene.title or "accelsurf",
            "tools": [{"name": one.name, "key": one.key, "text": one.text, "tip": one.tip} for one in tools],
            "keys": list(self.workplace.keys),
            "help": [list(row) for row in help_rows(self.workplace.keys)],
        })
        server.trigger("ask")(self._ask)
        server.trigger("shown")(self._was_shown)
        server.controller.on_server_bind.add(self._guard.install)
        with layout(server) as page:
            page.root.add_child(style(_read_text("page.css")))
            page.root.add_child(_document())
        return server

    def _state(self) -> dict[str, Any]:
        """What the page shows beside the picture."""
        link = f"files/{{}}?secret={self.token}"
        state = self.workplace.state()
        return state | {"files": [{"name": name, "link": link.format(name)} for name in state["saved"]]}

    def _ask(self, *request: Any, **_: Any) -> None:
        self.workplace.request(*request[:8])

    def _was_shown(self, *size: Any, **_: Any) -> None:
        """The page shows the last picture, in a window of this size."""
        self._is_shown = True
        before = tuple(self.scene.plotter.render_window.GetSize())
        changed = self.workplace.changed
        self.workplace.request("size", *size[:2])
        if tuple(self.scene.plotter.render_window.GetSize()) == before:
            self.workplace.changed = changed

    # -- serving ------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Serve until the task is cancelled.

        Raises
        ------
        OutputError
            When the server cannot listen on the address.
        """
        with _command_line_for_trame(self.token):
            task = self._server.start(
                exec_mode="coroutine", host=self._host, port=self._port, open_browser=False, thread=True,
                show_connection_info=False, disable_logging=True, timeout=0,
            )
        serving = asyncio.ensure_future(task)
        try:
            while not serving.done():
                await asyncio.sleep(POLL_SECONDS)
                if self._server.running and not self.address:
                    name = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
                    self._guard.watch()
                    self.address = f"http://{name}:{self._server.port}/index.html?secret={self.token}"
                self._update()
                self._guard.connections.close_idle()
            await serving
        except OSError as error:
            raise OutputError(
                f"{self._host}:{self._port}: cannot be listened on ({error.strerror or error})", "take another --port"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                await self._server.stop()
            serving.cancel()

    def _update(self) -> None:
        """Draw what is new, and send it to the page."""
        now = time.perf_counter()
        self.workplace.collect_results()
        # While a button is down the hand comes first.
        is_moving = self.workplace.feature(MouseFeature).is_moving
        view = None if is_moving else self.session.next_view(min(self._drawing))
        if view is not None:
            self.workplace.update(view)
        if view is not None or self.workplace.changed:
            self.quiet.touch()
            may_send = self._may_send(now)
            if may_send:
                self._drawing.append(self._draw())
            self.workplace.changed = not may_send
        elif self._may_send(now) and self.quiet.draw_in_full():
            self._draw()
        with self._server.state as state:
            state.update(self._state())

    def _may_send(self, now: float) -> bool:
        """Whether the page has shown the last picture; a slow page does not get more than it can show."""
        return self._is_shown or now - self._sent_at > PATIENCE

    def _draw(self) -> float:
        """Draw and send a picture; returns the seconds that it took."""
        began = time.perf_counter()
        data = _jpeg(self.scene.screenshot())
        self._server.state.picture = "data:image/jpeg;base64," + base64.b64encode(data).decode()
        self._sent_at, self._is_shown = time.perf_counter(), False
        return self._sent_at - began


#: The panels of the page, in their order, that of the window.
PANELS = ("head", "tools", "objects", "settings", "slices", "picture", "history", "files", "help")
#: A key by Qt's name of it; keys that are typed into a field, or turn a control, are left to it.
_ON_KEY = """
  const typed = ['INPUT', 'SELECT', 'TEXTAREA', 'BUTTON', 'SUMMARY', 'A'].includes($event.target.tagName);
  const names = {' ': 'Space', ArrowRight: 'Right', ArrowLeft: 'Left', ArrowUp: 'Up', ArrowDown: 'Down'};
  const key = names[$event.key] || ($event.key.length === 1 ? $event.key.toUpperCase() : $event.key);
  const name = ($event.ctrlKey ? 'Ctrl+' : '') + ($event.shiftKey && $event.ctrlKey ? 'Shift+' : '') + key;
  const copies = {'Ctrl+C': as_point, 'Ctrl+Shift+C': as_ball}[name];
  if (copies && $event.view.getSelection().isCollapsed && $event.view.navigator.clipboard) {
    $event.view.navigator.clipboard.writeText(copies); }
  if (!$event.altKey && !$event.metaKey && ($event.ctrlKey || !typed) && keys.includes(name)) {
    $event.preventDefault(); trigger('ask', ['key', name]); }
"""


def _document() -> str:
    """The page: panels and the picture."""
    panels = "\n".join(_read_text(f"{name}.html") for name in PANELS)
    on_key = html.escape(" ".join(_ON_KEY.split()))
    return f"""<div class="page" :class="theme" tabindex="0" autofocus @keydown="{on_key}">
<aside aria-label="panels">{panels}</aside>{_read_text("canvas.html")}</div>"""


def _read_text(name: str) -> str:
    return resources.files("accelsurf.viewer").joinpath("page", name).read_text(encoding="utf-8")


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    stream = io.BytesIO()
    # Full colour resolution: thin coloured lines on black.
    Image.fromarray(picture).save(stream, format="jpeg", quality=88, subsampling=0)
    return stream.getvalue()


@contextlib.contextmanager
def _command_line_for_trame(token: str) -> Iterator[None]:
    """Give trame a command line of its own: it would read ours."""
    ours, sys.argv = sys.argv, ["accelsurf", f"--authKey={token}"]
    try:
        yield
    finally:
        sys.argv = ours


def _import_trame() -> tuple[Any, Any, Any]:
    """What is used of trame: servers, a page that is a div, styles."""
    try:
        from trame.app import get_server
        from trame.ui.html import DivLayout
        from trame.widgets.client import Style
    except ImportError:
        raise UsageError("browser: trame is not installed", INSTALL) from None
    return get_server, DivLayout, Style
