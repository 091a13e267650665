"""The scene in a page: a session steered from a browser on this machine, served by trame.

The page shows pictures of the same scene as the window, drawn here, and sends requests, which `requests` checks. It
loads nothing from elsewhere. Whoever has the token of the address can change the run; nobody else is answered.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
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
from accelsurf.settings.energy_terms import examples
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.frontends.display import INSTALL
from accelsurf.viewer.frontends.page_guard import LOCAL, PageGuard
from accelsurf.viewer.frontends.requests import SETTINGS, RequestHandler
from accelsurf.viewer.scene.scene import Scene

#: Seconds between looks at the session; `Session.next_view` bounds the pictures per second.
POLL_SECONDS = 0.02
#: Seconds after the last change until edges are drawn smoothly, and until a page that shows nothing gets the next
#: picture all the same.
SMOOTH_DELAY, PATIENCE = 0.4, 2.0


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
    requests : RequestHandler
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
        self.requests = RequestHandler(session, scene, folder, overwrite)
        self.token, self.address = secrets.token_hex(24), ""
        self._guard = PageGuard(host, self.token, self.requests.files)
        self._host, self._port = host, port
        #: Seconds of the last pictures; the shortest counts: the first of a size takes long.
        self._drawing: deque[float] = deque([0.0], maxlen=3)
        self._changed_at, self._is_smooth = time.perf_counter(), True
        self._sent_at, self._is_shown = 0.0, True
        self._server = self._make_server()

    # -- the page -----------------------------------------------------------------------------------------

    def _make_server(self) -> Any:
        get_server, layout, style = _import_trame()
        server = get_server(f"accelsurf-{self.token[:8]}", client_type="vue3")
        server.state.update(self._state(self.session.status) | {
            "trame__title": "accelsurf", "picture": "", "title": self.scene.title or "accelsurf",
            "flows": list(FLOWS), "colors": list(COLORS),
            "radius_most": 0.5 * float(max(self.scene.geometry.extent_mm)),
        })
        server.trigger("ask")(self._ask)
        server.trigger("shown")(self._was_shown)
        server.controller.on_server_bind.add(self._guard.install)
        files = resources.files("accelsurf.viewer")
        with layout(server) as page:
            page.root.add_child(style(files.joinpath("page.css").read_text(encoding="utf-8")))
            page.root.add_child(files.joinpath("page.html").read_text(encoding="utf-8"))
        return server

    def _state(self, status: Status) -> dict[str, Any]:
        """What the page shows beside the picture."""
        requests, settings = self.requests, status.settings
        link = f"files/{{}}?secret={self.token}"
        return {
            "step": status.step, "last": max((status.step, *status.checkpoints)), "playing": status.playing,
            "state_word": status.word, "undoable": status.undoable, "redoable": status.redoable,
            "message": requests.message or status.message,
            "failed": bool(requests.message) or status.failed,
            **{key: getattr(settings, key) for key in SETTINGS},
            # The run's energy may be an expression that is not in the list.
            "energies": list(dict.fromkeys((*examples(), settings.energy))),
            "objects": ["nearest", *map(str, status.objects)] if status.objects else [],
            "object": str(requests.object_id or "nearest"),
            "mode": requests.mouse.mode, "radius": requests.mouse.radius, "color": requests.color,
            "theme": requests.theme, "volume": requests.volume, "planes": requests.planes,
            "files": [{"name": name, "link": link.format(name)} for name in sorted(requests.files)],
        }

    def _ask(self, *request: Any, **_: Any) -> None:
        self.requests.request(*request[:8])

    def _was_shown(self, *size: Any, **_: Any) -> None:
        """The page shows the last picture, in a window of this size."""
        self._is_shown = True
        before = tuple(self.scene.plotter.render_window.GetSize())
        changed = self.requests.changed
        self.requests.request("size", *size[:2])
        if tuple(self.scene.plotter.render_window.GetSize()) == before:
            self.requests.changed = changed

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
        self.requests.collect_results()
        view = self.session.next_view(min(self._drawing))
        if view is not None:
            self.scene.update(view.frame, view.histories)
        if view is not None or self.requests.changed:
            self._changed_at, self._is_smooth = now, False
            may_send = self._may_send(now)
            if may_send:
                self._drawing.append(self._draw(smooth=False))
            self.requests.changed = not may_send
        elif not self._is_smooth and now - self._changed_at > SMOOTH_DELAY and self._may_send(now):
            self._draw(smooth=True)
            self._is_smooth = True
        with self._server.state as state:
            state.update(self._state(self.session.status))

    def _may_send(self, now: float) -> bool:
        """Whether the page has shown the last picture; a slow page does not get more than it can show."""
        return self._is_shown or now - self._sent_at > PATIENCE

    def _draw(self, smooth: bool) -> float:
        """Draw and send a picture; returns the seconds that it took."""
        began = time.perf_counter()
        self.scene.smooth_edges(smooth)
        data = _jpeg(self.scene.screenshot())
        self._server.state.picture = "data:image/jpeg;base64," + base64.b64encode(data).decode()
        self._sent_at, self._is_shown = time.perf_counter(), False
        return self._sent_at - began


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
