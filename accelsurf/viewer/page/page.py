"""The scene in a page: a session steered from a browser on this machine, served by trame; before that the start page.

The page shows pictures of the same scene as the window, drawn here, and sends requests; each is checked. Its document
has panels, the picture and keys; it loads nothing from elsewhere. Whoever has the token of the address can change the
run; nobody else is answered.
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
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from numpy.typing import NDArray
from PIL import Image

from accelsurf.errors import AccelsurfError, OutputError, UsageError
from accelsurf.image.grey_window import parse_window
from accelsurf.viewer.actions.actions import Actions, IdleDrawing
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.opening import Opening, ViewerSettings
from accelsurf.viewer.actions.picture import PictureFeature
from accelsurf.viewer.actions.tool import help_rows
from accelsurf.viewer.core.opening import ImageWithSession, OpenedImage
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.status import error_line
from accelsurf.viewer.page.guard import LOCAL, PageGuard
from accelsurf.viewer.scene.colors import ALARM, EDGE, MARK, ON_SURFACE, SURFACE
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.window.display import INSTALL_WINDOW

#: Seconds between looks at the session; `Session.next_view` bounds the pictures per second.
POLL_SECONDS = 0.02
#: Seconds until a page that shows nothing gets the next picture all the same.
PATIENCE = 2.0


class Page:
    """The start page, or the image that is open.

    Parameters
    ----------
    opening : Opening
    settings : ViewerSettings
    temporary : Path
        An empty folder, for saved files where the settings name no folder.
    host : str, optional
        Address to listen on; by default of this machine alone.
    port : int, optional
        0 takes a free one.

    Attributes
    ----------
    actions : Actions or None
        Of the image that is open; drawn in the thread that serves.
    token : str
        Whoever has it can change the run.
    address : str
        URL to open, with the token; empty before the page is served.

    Raises
    ------
    UsageError
        When trame is not installed.
    """

    def __init__(
        self,
        opening: Opening,
        settings: ViewerSettings,
        temporary: Path,
        host: str = LOCAL,
        port: int = 0,
    ) -> None:
        self.opening, self._settings = opening, settings
        self.actions: Actions | None = None
        self._folder = settings.folder or temporary
        #: The room that the page has said the picture has, and its pixels; nothing before.
        self._room: tuple[Any, ...] = ()
        self.token, self.address = secrets.token_hex(24), ""
        self._guard = PageGuard(host, self.token, self._saved_files)
        self._host, self._port = host, port
        #: Seconds of the last pictures; the shortest counts: the first of a size takes long.
        self._drawing: deque[float] = deque([0.0], maxlen=3)
        self.idle: IdleDrawing | None = None
        self._sent_at, self._is_shown = 0.0, True
        self._server = self._make_server()
        #: Loads PyVista, which takes seconds, while the person chooses.
        self._loading = threading.Thread(target=getattr, args=(pyvista, "Plotter"), daemon=True)
        self._loading.start()

    # -- the page -----------------------------------------------------------------------------------------

    def _make_server(self) -> Any:
        get_server, layout, style = _import_trame()
        server = get_server(f"accelsurf-{self.token[:8]}", client_type="vue3")
        first = {"trame__title": "accelsurf", "theme": self._settings.theme, "picture": ""}
        server.state.update(first | self._state())
        server.trigger("ask")(self._ask)
        server.trigger("shown")(self._was_shown)
        server.controller.on_server_bind.add(self._guard.install)
        self._layout, self._style = layout(server), style
        self._lay_out()
        return server

    def _lay_out(self) -> None:
        """Lay out the page, which has other parts when an image is open."""
        with self._layout as page:
            page.root.clear()
            page.root.add_child(self._style(style_sheet()))
            page.root.add_child(document(() if self.actions is None else PANELS))

    def _state(self) -> dict[str, Any]:
        """Return the state that the page shows beside the picture."""
        state = self.opening.state()
        if self.actions is None:
            return state
        link = f"files/{{}}?secret={self.token}"
        state |= self.actions.state()
        return state | {
            "files": [{"name": name, "link": link.format(name)} for name in state["saved"]]
        }

    def _saved_files(self) -> Mapping[str, Path]:
        return {} if self.actions is None else self.actions.feature(FilesFeature).files

    def _ask(self, *request: Any, **_: Any) -> None:
        name = request[0] if request else None
        if self.actions is None or (isinstance(name, str) and name in self.opening.names):
            self.opening.request(*(request[:8] or (None,)))
        else:
            self.actions.request(*request[:8])

    def _was_shown(self, *size: Any, **_: Any) -> None:
        """Note that the page shows the last picture, and its room: width, height, pixels of the device for one."""
        self._is_shown = True
        if self.actions is not None:
            self._room = size[:3]
            self.actions.request("size", *self._room)

    # -- images -------------------------------------------------------------------------------------------

    def open(self, opened: OpenedImage, session: Session | None = None) -> None:
        """Show an image in place of the present one.

        Parameters
        ----------
        opened : OpenedImage
        session : Session, optional
            Of it; one is begun otherwise.

        Raises
        ------
        GraphicsError, InputError
            When it cannot be drawn; the present image stays.
        """
        self._loading.join()
        settings, former = self._settings, self.actions
        theme = settings.theme if former is None else former.scene.theme_name
        scene = Scene(
            opened.volume,
            theme=theme,
            reference=opened.reference,
            title=None if opened.source is not None else opened.name,
            window=parse_window(opened.config.window),
        )
        if former is not None:
            former.scene.close()
        session = opened.session(settings.checkpoint_mb) if session is None else session
        folder = self.opening.results_of_next(self._folder, opened.name)
        self.actions = Actions(session, scene, folder, settings.overwrite, opened.frames)
        self.idle = IdleDrawing(self.actions)
        if self._room:
            self.actions.request("size", *self._room)
        self._drawing.extend((0.0,) * 3)
        self._is_shown = True
        self.opening.show(self.actions, opened)
        tools, keys = self.actions.tools.values(), self.actions.keys
        with self._server.state as state:
            state.update(
                self._state()
                | {
                    "picture": "",
                    "title": scene.title or "accelsurf",
                    "keys": list(keys),
                    "tools": [
                        {"name": tool.name, "key": tool.key, "text": tool.text, "tip": tool.tip}
                        for tool in tools
                    ],
                    "help": [list(row) for row in help_rows(keys)],
                }
            )
            self._lay_out()

    def close(self) -> None:
        """Close the image; sessions finish their commands."""
        if self.actions is not None:
            self.actions.scene.close()
        self.opening.close()

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
                exec_mode="coroutine",
                host=self._host,
                port=self._port,
                open_browser=False,
                thread=True,
                show_connection_info=False,
                disable_logging=True,
                timeout=0,
            )
        serving = asyncio.ensure_future(task)
        try:
            while not serving.done():
                await asyncio.sleep(POLL_SECONDS)
                if self._server.running and not self.address:
                    name = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
                    self._guard.watch()
                    self.address = (
                        f"http://{name}:{self._server.port}/index.html?secret={self.token}"
                    )
                self._update()
                self._guard.connections.close_idle()
            await serving
        except OSError as error:
            raise OutputError(
                f"{self._host}:{self._port}: cannot be listened on ({error.strerror or error})",
                "take another --port",
            ) from None
        finally:
            with contextlib.suppress(Exception):
                await self._server.stop()
            serving.cancel()

    def _update(self) -> None:
        """Draw changes, and send them to the page."""
        opened = self.opening.fetch()
        if opened is not None:
            try:
                self.open(opened)
            except AccelsurfError as error:
                self.opening.say(error_line(error), failed=True)
        if self.actions is not None and self.idle is not None:
            self._update_picture(self.actions, self.idle)
        with self._server.state as state:
            state.update(self._state())

    def _update_picture(self, actions: Actions, idle: IdleDrawing) -> None:
        """Draw changes, and send them."""
        now = time.perf_counter()
        view = actions.poll(min(self._drawing))
        if view is not None or actions.changed:
            idle.interrupt()
            actions.feature(PictureFeature).draw_fine(False)
            if self._may_send(now):
                self._drawing.append(self._draw(actions))
        elif self._may_send(now) and idle.draw_in_full():
            actions.feature(PictureFeature).draw_fine(True)
            self._draw(actions)

    def _may_send(self, now: float) -> bool:
        """Test if the page has shown the last picture; a slow page does not get more than it can show."""
        return self._is_shown or now - self._sent_at > PATIENCE

    def _draw(self, actions: Actions) -> float:
        """Draw and send a picture; returns the seconds that it took."""
        began = time.perf_counter()
        data = _jpeg(actions.scene.screenshot())
        self._server.state.picture = "data:image/jpeg;base64," + base64.b64encode(data).decode()
        self._sent_at, self._is_shown = time.perf_counter(), False
        return self._sent_at - began


#: The panels of the page, in their order, that of the window.
PANELS = (
    "head",
    "tools",
    "result",
    "objects",
    "history",
    "settings",
    "slices",
    "picture",
    "open",
    "help",
)


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
    """Return the parts of trame in use: servers, a page that is a div, styles."""
    try:
        from trame.app import get_server
        from trame.ui.html import DivLayout
        from trame.widgets.client import Style
    except ImportError:
        raise UsageError("browser: trame is not installed", INSTALL_WINDOW) from None
    return get_server, DivLayout, Style


def serve(
    opening: Opening,
    first: ImageWithSession | None,
    settings: ViewerSettings,
    host: str = LOCAL,
    port: int = 0,
    on_ready: Callable[[str], None] | None = None,
    ends: Callable[[], bool] = lambda: False,
) -> None:
    """Serve the page until it is to end, or until Ctrl-C.

    Parameters
    ----------
    opening : Opening
    first : ImageWithSession or None
        The image that is open at first; None for the start page.
    settings : ViewerSettings
        Files saved in a temporary folder can be downloaded; they are deleted at the end.
    host, port : str, int, optional
        As of `Page`.
    on_ready : callable, optional
        Called with the address, once the page is served.
    ends : callable, optional
        Says whether it is to end; asked again and again.

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
        temporary = stack.enter_context(tempfile.TemporaryDirectory(prefix="accelsurf-"))
        page = Page(opening, settings, Path(temporary), host, port)
        stack.callback(page.close)
        if first is not None:
            page.open(*first)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve(page, on_ready, ends))


async def _serve(
    page: Page, on_ready: Callable[[str], None] | None, ends: Callable[[], bool]
) -> None:
    serving = asyncio.ensure_future(page.serve())
    is_announced = False
    while not serving.done():
        await asyncio.sleep(POLL_SECONDS)
        if page.address and not is_announced:
            is_announced = True
            if on_ready is not None:
                on_ready(page.address)
        if ends():
            serving.cancel()
            break
    with contextlib.suppress(asyncio.CancelledError):
        await serving


#: A key by Qt's name of it; keys that are typed into a field, or turn a control, are left to it.
_ON_KEY = """
  const typed = ['INPUT', 'SELECT', 'TEXTAREA', 'BUTTON', 'SUMMARY', 'A'].includes($event.target.tagName);
  const names = {' ': 'Space', ArrowRight: 'Right', ArrowLeft: 'Left', ArrowUp: 'Up', ArrowDown: 'Down'};
  const key = names[$event.key] || ($event.key.length === 1 ? $event.key.toUpperCase() : $event.key);
  const name = ($event.ctrlKey ? 'Ctrl+' : '') + ($event.shiftKey && $event.ctrlKey ? 'Shift+' : '') + key;
  const words = {'Ctrl+C': as_point, 'Ctrl+Shift+C': as_ball, '/': as_correction}[name];
  const selects = name === 'Ctrl+C' && (!$event.view.getSelection().isCollapsed
    || $event.target.matches('input[type=text], input[type=number], textarea'));
  if (!$event.altKey && !$event.metaKey && ($event.ctrlKey || !typed) && keys.includes(name) && !selects) {
    $event.preventDefault(); trigger('ask', ['key', name]);
    if (words) { COPY } }
"""

#: Puts ``words`` on the clipboard. A page on http of another machine has none of its own; there a text is selected and
#: copied as a person would, and who had the keys has them again.
_COPY = """
  const view = $event.view, failed = () => trigger('ask', ['copy_failed']);
  if (view.navigator.clipboard) { view.navigator.clipboard.writeText(words).catch(failed); }
  else {
    const field = view.document.getElementById('copied'), before = view.document.activeElement;
    field.value = words; field.select();
    if (!view.document.execCommand('copy')) { failed(); }
    before.focus();
  }
"""

#: Where a pointer is, as parts of the width and of the height from the top; a drag may leave the picture.
_PLACE = ", ".join(
    f"Math.min(Math.max($event.offset{axis} / $event.target.client{side}, 0), 1)"
    for axis, side in (("X", "Width"), ("Y", "Height"))
)


#: A file that is dropped on the page would take its place.
_NO_DROP = '@dragover.prevent="0" @drop.prevent="0"'


def document(panels: Sequence[str]) -> str:
    """Return the page: panels and the picture, or, where there are no panels, the start page.

    Parameters
    ----------
    panels : sequence of str
        Names of their files, in their order.
    """
    asked = page_text("opening.html")
    if not panels:
        begin = f'<div class="begin">{_with_lists("start.html")}{asked}</div>'
        return f'<div class="page" :class="theme" {_NO_DROP}>{begin}</div>'
    inner = "\n".join(_with_lists(f"{name}.html") for name in panels)
    on_key = _inline(_ON_KEY.replace("COPY", _COPY))
    canvas = (
        page_text("canvas.html")
        .replace("PLACE", _inline(_PLACE))
        .replace("FRAMES", page_text("frames.html"))
    )
    return f"""<div class="page" :class="theme" tabindex="0" autofocus @keydown="{on_key}" {_NO_DROP}>
{canvas}<details class="panels" open><summary id="fold">Panels</summary>
<aside aria-label="panels">{asked}{inner}</aside></details>
<textarea id="copied" class="aside" readonly tabindex="-1" aria-hidden="true"></textarea></div>"""


def style_sheet() -> str:
    """Return the style sheet of the page, with the colours that it shares with the scene and the window."""
    shared = {"main": SURFACE, "on": ON_SURFACE, "mark": MARK}
    dark = {**shared, "edge": EDGE["dark"], "alarm": ALARM["dark"]}
    light = {"edge": EDGE["light"], "alarm": ALARM["light"]}
    sheets = ((".page", dark), (".page.light", light))
    colors_of_page = "\n".join(
        f"{where} {{ {' '.join(f'--{name}: {color};' for name, color in colors.items())} }}"
        for where, colors in sheets
    )
    return f"{colors_of_page}\n{page_text('page.css')}"


def _inline(script: str) -> str:
    """A script as the value of an attribute."""
    return html.escape(" ".join(script.split()))


def _with_lists(name: str) -> str:
    """A file of the page, with the lists to open from where it has them."""
    return page_text(name).replace("LISTS", page_text("lists.html"))


def page_text(name: str) -> str:
    """Return the text of a file of the page."""
    return resources.files("accelsurf.viewer").joinpath("page", name).read_text(encoding="utf-8")
