"""The scene in a page: a session steered from a browser on this machine, served by trame.

The page shows pictures of the same scene as the window, drawn here, and sends requests, which `steering` checks. It
loads nothing from elsewhere. Whoever has the token of the address can change the run; nobody else is answered.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hmac
import io
import secrets
import socket
import struct
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from accelsurf.errors import OutputError, UsageError
from accelsurf.grid.volume import Volume
from accelsurf.settings.energy_terms import examples
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.session import Session, Status
from accelsurf.viewer.frontends.requests import SETTINGS, Steering
from accelsurf.viewer.scene.scene import Scene

LOCAL = "127.0.0.1"
#: Seconds between looks at the session; pictures a second at most follow from `Session.take`.
PAUSE = 0.02
#: Seconds after the last change until edges are drawn smoothly, and until a page that shows nothing is given up on.
CALM, PATIENCE = 0.4, 2.0
#: Bytes of the longest message that a page may send: its requests have a few numbers each.
MAX_BYTES = 16384
#: What a page's messages may ask of trame; the first says the token.
METHODS = ("wslink.hello", "trame.state.get", "trame.trigger", "trame.lifecycle.update", "trame.state.update")
#: Those whose arguments are not listened to, and what is put in their place.
HARMLESS: dict[str, Any] = {"trame.lifecycle.update": "page", "trame.state.update": []}
#: Nothing from elsewhere may be loaded, and the address with its token goes to nobody.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; connect-src 'self' ws: wss:; frame-ancestors 'none'; form-action 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
_HEADER = struct.Struct("<III")


class Page:
    """A session in a page.

    Parameters
    ----------
    session : Session
    scene : Scene
        Of the same image; drawn in the thread that serves.
    folder : Path
        Where files are saved and handed out from.
    host : str, optional
        Address to listen on; of this machine alone unless told.
    port : int, optional
        0 takes a free one.
    overwrite : bool, optional
        Replace files in the folder that this session has not written.

    Attributes
    ----------
    steering : Steering
    token : str
        Whoever has it can change the run.
    address : str
        What to open, token and all; empty before the page is served.

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
        self._trame = _trame()
        self.session, self.scene = session, scene
        self.steering = Steering(session, scene, folder, overwrite)
        self.token, self.address = secrets.token_urlsafe(24), ""
        self._host, self._port = host, port
        #: Seconds of the last pictures; the fastest counts: the first of a size takes long.
        self._drawing: deque[float] = deque([0.0], maxlen=3)
        self._changed_at, self._smooth = time.perf_counter(), True
        self._sent_at, self._shown = 0.0, True
        self._server = self._made()

    # -- the page ------------------------------------------------------------------------------------------

    def _made(self) -> Any:
        get_server, layout, style = self._trame
        server = get_server(f"accelsurf-{self.token[:8]}", client_type="vue3")
        server.state.update(self._state(self.session.status) | {
            "trame__title": "accelsurf", "picture": "", "title": self.steering.scene.title or "accelsurf",
            "flows": list(FLOWS), "colors": list(COLORS),
            "radius_most": 0.5 * float(max(self.scene.geometry.extent_mm)),
        })
        server.trigger("ask")(self._ask)
        server.trigger("shown")(self._was_shown)
        server.controller.on_server_bind.add(self._guard)
        files = resources.files("accelsurf.viewer")
        with layout(server) as page:
            page.root.add_child(style(files.joinpath("page.css").read_text(encoding="utf-8")))
            page.root.add_child(files.joinpath("page.html").read_text(encoding="utf-8"))
        return server

    def _state(self, status: Status) -> dict[str, Any]:
        """What the page shows beside the picture."""
        steering, settings = self.steering, status.settings
        word = "running" if status.running else status.stop.reason if status.stop else "paused" if status.ready else ""
        link = f"files/{{}}?secret={self.token}"
        return {
            "step": status.step, "last": max((status.step, *status.kept)), "running": status.running,
            "state_word": word, "undoable": status.undoable, "message": steering.message or status.message,
            "failed": bool(steering.message) or status.failed,
            **{key: getattr(settings, key) for key in SETTINGS},
            # An expression of the run's own stands beside those that there are to choose from.
            "energies": list(dict.fromkeys((*examples(), settings.energy))),
            "mode": steering.mouse.mode, "radius": steering.mouse.radius, "color": steering.color,
            "theme": steering.theme, "volume": steering.volume, "planes": steering.planes,
            "files": [{"name": name, "link": link.format(name)} for name in sorted(steering.files)],
        }

    def _ask(self, *request: Any, **_: Any) -> None:
        self.steering.request(*request[:8])

    def _was_shown(self, *size: Any, **_: Any) -> None:
        self._shown = True
        before = tuple(self.scene.plotter.render_window.GetSize())
        changed = self.steering.changed
        self.steering.request("size", *size[:2])
        if tuple(self.scene.plotter.render_window.GetSize()) == before:
            self.steering.changed = changed

    # -- serving -------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Serve until the task is cancelled.

        Raises
        ------
        OutputError
            When the address cannot be listened on.
        """
        with _own_arguments(self.token):
            task = self._server.start(
                exec_mode="coroutine", host=self._host, port=self._port, open_browser=False, thread=True,
                show_connection_info=False, disable_logging=True, timeout=0,
            )
        serving = asyncio.ensure_future(task)
        try:
            while not serving.done():
                await asyncio.sleep(PAUSE)
                if self._server.running and not self.address:
                    name = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
                    self.address = f"http://{name}:{self._server.port}/index.html?secret={self.token}"
                self._look()
            await serving
        except OSError as error:
            raise OutputError(
                f"{self._host}:{self._port}: cannot be listened on ({error.strerror or error})", "take another --port"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                await self._server.stop()
            serving.cancel()

    def _look(self) -> None:
        """Draw what is new, and tell the page."""
        now = time.perf_counter()
        self.steering.look_after()
        view = self.session.take(min(self._drawing))
        if view is not None:
            self.scene.update(view.frame, view.rows)
        if view is not None or self.steering.changed:
            self._changed_at, self._smooth = now, False
            may = self._may_send(now)
            if may:
                self._drawing.append(self._draw(False))
            self.steering.changed = not may
        elif not self._smooth and now - self._changed_at > CALM and self._may_send(now):
            self._draw(True)
            self._smooth = True
        with self._server.state as state:
            state.update(self._state(self.session.status))

    def _may_send(self, now: float) -> bool:
        """Whether the page has shown the last picture: one that is slow is not buried in them."""
        return self._shown or now - self._sent_at > PATIENCE

    def _draw(self, smoothly: bool) -> float:
        """Draw and send a picture; returns the seconds that it took."""
        began = time.perf_counter()
        self.scene.smooth_edges(smoothly)
        data = _jpeg(self.scene.screenshot())
        self._server.state.picture = "data:image/jpeg;base64," + base64.b64encode(data).decode()
        self._sent_at, self._shown = time.perf_counter(), False
        return self._sent_at - began

    # -- who may come in -----------------------------------------------------------------------------------

    def _guard(self, web: Any) -> None:
        """Before the server listens: look at every request and every message first."""
        from aiohttp import web as aiohttp_web

        @aiohttp_web.middleware
        async def look(request: Any, handler: Any) -> Any:
            if not self._is_addressed(request):
                return aiohttp_web.Response(status=403, text="this page is not served under that name")
            return await handler(request)

        async def head(_: Any, response: Any) -> None:
            response.headers.update(HEADERS)

        web.app.middlewares.append(look)
        web.app.on_response_prepare.append(head)
        web.app.router.add_get("/files/{name}", self._hand_out)
        for handler in web._ws_handlers:
            handler.onMessage = _guarded(handler)

    def _is_addressed(self, request: Any) -> bool:
        """Whether a request came to the address that was opened, and from its page: no other site may ask."""
        host = request.headers.get("Host", "")
        if self._host == LOCAL and host.rpartition(":")[0] not in (LOCAL, "localhost"):
            return False
        origin = request.headers.get("Origin")
        return origin is None or origin.partition("://")[2] == host

    async def _hand_out(self, request: Any) -> Any:
        """One of the files that were saved, by its name alone."""
        from aiohttp import web as aiohttp_web

        if not hmac.compare_digest(request.query.get("secret", "").encode(), self.token.encode()):
            return aiohttp_web.Response(status=403, text="the token is not right")
        path = self.steering.files.get(request.match_info["name"])
        if path is None or not path.is_file():
            return aiohttp_web.Response(status=404, text="no such file")
        headers = {"Content-Disposition": f'attachment; filename="{path.name}"'}
        return aiohttp_web.FileResponse(path, headers=headers)


def _guarded(handler: Any) -> Any:
    """What looks at a message before trame does: one that a page of ours would not send ends the connection.

    trame would take up to 4 GB at the word of a header, any change of its state, and any of its calls.
    """
    import msgpack

    inner = handler.onMessage

    async def on_message(is_binary: bool, message: Any, client: str) -> None:
        try:
            if not is_binary:
                raise ValueError("text")
            _, offset, total = _HEADER.unpack_from(message.data)
            body = message.data[_HEADER.size :]
            if offset or total != len(body) or total > MAX_BYTES:
                raise ValueError("size")
            call = msgpack.unpackb(body)
            if not isinstance(call["id"], str) or not isinstance(call.get("args", []), list):
                raise ValueError("call")
            if call["method"] not in METHODS:
                raise ValueError("method")
            if call["method"] == "trame.trigger" and call["args"][0] not in ("ask", "shown"):
                raise ValueError("trigger")
            if call["method"] in HARMLESS:
                # The page's bookkeeping wants an answer, but the state and what happens here are ours.
                body = msgpack.packb({**call, "args": [HARMLESS[call["method"]]], "kwargs": {}})
                message = message._replace(data=_HEADER.pack(0, 0, len(body)) + body)
            await inner(is_binary, message, client)
        except Exception:
            connection = handler.connections.get(client)
            if connection is not None:
                await connection.close(code=1008, message=b"not understood")

    return on_message


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    stream = io.BytesIO()
    # Full colour resolution: thin coloured lines on black.
    Image.fromarray(picture).save(stream, format="jpeg", quality=88, subsampling=0)
    return stream.getvalue()


@contextlib.contextmanager
def _own_arguments(token: str) -> Iterator[None]:
    """Give trame a command line of its own: it would read ours."""
    kept, sys.argv = sys.argv, ["accelsurf", "--authKey", token]
    try:
        yield
    finally:
        sys.argv = kept


def _trame() -> tuple[Any, Any, Any]:
    """What is used of trame: servers, a page that is a div, styles."""
    try:
        from trame.app import get_server
        from trame.ui.html import DivLayout
        from trame.widgets.client import Style
    except ImportError:
        raise UsageError("browser: trame is not installed", 'pip install "accelsurf[viewer]"') from None
    return get_server, DivLayout, Style


def serve(
    session: Session,
    reference: Volume | None,
    folder: Path | None,
    theme: str,
    overwrite: bool = False,
    host: str = LOCAL,
    port: int = 0,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Serve a session in a page until Ctrl-C.

    Parameters
    ----------
    session : Session
    reference : Volume or None
        Labels to compare with.
    folder : Path or None
        Where files are saved; None: a folder that is gone afterwards, from which they can be downloaded.
    theme : str
        "dark" or "light".
    overwrite : bool, optional
        Replace files there that this session has not written.
    host, port : str, int, optional
        As of `Page`.
    tell : callable, optional
        Called with the address, once the page is there.

    Raises
    ------
    UsageError
        When trame is not installed.
    OutputError
        When the address cannot be listened on.
    GraphicsError
        When nothing can be drawn here.
    """
    _trame()
    scene = Scene(session.volume, theme=theme, reference=reference)
    with contextlib.ExitStack() as stack:
        stack.callback(scene.close)
        home = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="accelsurf-")))
        page = Page(session, scene, home, host, port, overwrite)
        page.steering.theme = theme
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve(page, tell))


async def _serve(page: Page, tell: Callable[[str], None] | None) -> None:
    serving = asyncio.ensure_future(page.serve())
    while not page.address and not serving.done():
        await asyncio.sleep(PAUSE)
    if page.address and tell is not None:
        tell(page.address)
    await serving
