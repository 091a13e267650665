"""Guard of a page's server: every request and message is checked before trame gets it; connections are limited."""

from __future__ import annotations

import contextlib
import hmac
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Connections at the same time; a browser opens up to six for each page, and one that stays.
MAX_CONNECTIONS = 64
#: Seconds that a connection without the token may stay idle, or take for a request.
MAX_IDLE = 30.0


@dataclass
class _Connection:
    """An open connection: its transport, the time of its last request, and whether it gave the token."""

    transport: Any
    since: float
    trusted: bool = False


class ConnectionLimit:
    """Closes connections that are too many, and those that stay without the token.

    Connections are known by the address and port of the other end, which no two have at the same time.

    Attributes
    ----------
    connections : dict
        The open ones, the oldest first.
    """

    def __init__(self) -> None:
        self.connections: dict[Any, _Connection] = {}

    def watch(self, http_server: Any) -> None:
        """Watch an aiohttp server that listens: it says when a connection is made and lost."""
        made, lost = http_server.connection_made, http_server.connection_lost

        terse = _terse_handler()

        def connection_made(protocol: Any, transport: Any) -> None:
            if isinstance(protocol, terse.__bases__):
                protocol.__class__ = terse
            made(protocol, transport)
            self._opened(transport)

        def connection_lost(protocol: Any, error: BaseException | None = None) -> None:
            transport = getattr(protocol, "transport", None)
            lost(protocol, error)
            if transport is not None:
                self.connections.pop(_peer(transport), None)

        http_server.connection_made, http_server.connection_lost = connection_made, connection_lost

    def _opened(self, transport: Any) -> None:
        """Take a new connection; where there are too many, the oldest without the token is closed, or else this one."""
        self.connections[_peer(transport)] = _Connection(transport, time.monotonic())
        if len(self.connections) > MAX_CONNECTIONS:
            self._close(
                next(
                    (peer for peer, known in self.connections.items() if not known.trusted),
                    _peer(transport),
                )
            )

    def requested(self, transport: Any) -> None:
        """Note that a request came over a connection."""
        connection = self.connections.get(_peer(transport))
        if connection is not None:
            connection.since = time.monotonic()

    def trust(self, transport: Any) -> None:
        """Note that a connection gave the token."""
        connection = self.connections.get(_peer(transport))
        if connection is not None:
            connection.trusted = True

    def close_idle(self) -> None:
        """Close the connections that were idle for too long."""
        latest = time.monotonic() - MAX_IDLE
        for peer, connection in list(self.connections.items()):
            if not connection.trusted and connection.since < latest:
                self._close(peer)

    def _close(self, peer: Any) -> None:
        self.connections.pop(peer).transport.abort()


def _terse_handler() -> type[Any]:
    """Return aiohttp's handler of a connection, with a line for bytes that are no request.

    aiohttp would send them back, of whatever length, and print a traceback. A server that listens takes no other class.
    """
    from aiohttp import web
    from aiohttp.http_exceptions import HttpProcessingError

    class Terse(web.RequestHandler):
        __slots__ = ()

        def handle_error(
            self,
            request: Any,
            status: int = 500,
            exc: BaseException | None = None,
            message: str | None = None,
        ) -> Any:
            if not isinstance(exc, HttpProcessingError):
                return super().handle_error(request, status, exc, message)
            answer = web.Response(status=status, text="this request is not understood")
            answer.force_close()
            return answer

    return Terse


def _peer(transport: Any) -> Any:
    """Address and port of the other end."""
    return transport.get_extra_info("peername")


#: Address of this machine alone.
LOCAL = "127.0.0.1"
#: Bytes of the longest message that a page may send: its requests have a few numbers each.
MAX_BYTES = 16384
#: Letters of the longest address: that of a saved file has its name and the token.
MAX_ADDRESS = 2048
#: Where trame listens for the page's messages.
SOCKET = "/ws"
#: Methods of trame that a page's messages may call; the first has the token.
METHODS = (
    "wslink.hello",
    "trame.state.get",
    "trame.trigger",
    "trame.lifecycle.update",
    "trame.state.update",
)
#: Methods whose arguments are ignored, and the arguments in their place.
IGNORED: dict[str, Any] = {"trame.lifecycle.update": "page", "trame.state.update": []}
#: Triggers of the page, see `page.Page`.
TRIGGERS = ("ask", "shown")
#: Nothing from elsewhere may be loaded, and no other site learns the address with its token.
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


class PageGuard:
    """Checks requests and messages, and serves the saved files.

    Parameters
    ----------
    host : str
        Address that the server listens on.
    token : str
        Whoever has it may download the files.
    files : callable
        Returns the files that may be downloaded, by name; called at each request.
    """

    def __init__(self, host: str, token: str, files: Callable[[], Mapping[str, Path]]) -> None:
        self._host = host
        self._token = token
        self._files = files
        self.connections = ConnectionLimit()
        self._server: Any = None

    def install(self, server: Any) -> None:
        """Put the checks before a server's own, before it listens."""
        from aiohttp import web

        @web.middleware
        async def check(request: Any, handler: Any) -> Any:
            if not self._is_addressed(request):
                return web.Response(status=403, text="this page is not served under that name")
            self.connections.requested(request.transport)
            if len(request.raw_path) > MAX_ADDRESS:
                return web.Response(status=414, text="the address is too long")
            if request.path == SOCKET:
                if web.WebSocketResponse().can_prepare(request).ok:
                    return await handler(request)
                return web.Response(status=400, text="a WebSocket is expected under this address")
            try:
                return await handler(request)
            except (OSError, ValueError):  # a name that no file can have
                return web.Response(status=404, text="no such file")

        async def add_headers(_: Any, response: Any) -> None:
            response.headers.update(HEADERS)

        self._server = server
        server.app.middlewares.append(check)
        server.app.on_response_prepare.append(add_headers)
        server.app.router.add_get("/files/{name}", self._download)
        for handler in server._ws_handlers:
            handler.onMessage = self._checked(handler)
            handler.getAuthenticatedWebsockets = _may_leave(handler.getAuthenticatedWebsockets)

    def watch(self) -> None:
        """Limit the connections of the installed server, once it listens."""
        self.connections.watch(self._server.runner.server)

    def _is_addressed(self, request: Any) -> bool:
        """Test if a request came to the address that was opened, and from its page: no other site may ask."""
        host = request.headers.get("Host", "")
        if self._host == LOCAL and host.rpartition(":")[0] not in (LOCAL, "localhost"):
            return False
        origin = request.headers.get("Origin")
        return origin is None or origin.partition("://")[2] == host

    def has_token(self, request: Any) -> bool:
        """Test if a request has the token; its connection is trusted then."""
        if not hmac.compare_digest(request.query.get("secret", "").encode(), self._token.encode()):
            return False
        self.connections.trust(request.transport)
        return True

    async def _download(self, request: Any) -> Any:
        """One of the saved files, by its name alone."""
        from aiohttp import web

        if not self.has_token(request):
            return web.Response(status=403, text="the token is not right")
        path = self._files().get(request.match_info["name"])
        if path is None or not path.is_file():
            return web.Response(status=404, text="no such file")
        headers = {"Content-Disposition": f'attachment; filename="{path.name}"'}
        return web.FileResponse(path, headers=headers)

    def _checked(self, handler: Any) -> Any:
        """Check a message before trame gets it: one that no page of ours would send ends the connection.

        trame itself would reserve up to 4 GB because a header says so, and allow any change of its state and any call.
        """
        inner = handler.onMessage

        async def on_message(is_binary: bool, message: Any, client: str) -> None:
            connection = handler.connections.get(client)
            try:
                if not is_binary:
                    raise ValueError("text")
                await inner(is_binary, message._replace(data=_checked_bytes(message.data)), client)
                if client in handler.authentified_client_ids:
                    self.connections.trust(connection)
            except Exception:
                if connection is not None:
                    await connection.close(code=1008, message=b"not understood")

        return on_message


class _PageThatMayLeave:
    """A page's connection, to send over: data for a page that has left are dropped."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection

    async def send_bytes(self, data: bytes) -> None:
        with contextlib.suppress(ConnectionError):
            await self._connection.send_bytes(data)


def _may_leave(connections_of: Callable[..., list[Any]]) -> Callable[..., list[_PageThatMayLeave]]:
    """Let a page leave at any moment.

    wslink lists a page until its end is noticed. A message in between would fail, with a traceback in the terminal,
    and the pages after it in the list would not get theirs.
    """

    def connections(*args: Any, **options: Any) -> list[_PageThatMayLeave]:
        return [
            _PageThatMayLeave(page) for page in connections_of(*args, **options) if page is not None
        ]

    return connections


def _checked_bytes(data: bytes) -> bytes:
    """Return a message as trame may have it; ValueError, KeyError, TypeError and so on for one that it may not."""
    import msgpack

    _, offset, total = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    if offset or total != len(body) or total > MAX_BYTES:
        raise ValueError("size")
    call = msgpack.unpackb(body)
    if not isinstance(call["id"], str) or not isinstance(call.get("args", []), list):
        raise ValueError("call")
    if call["method"] not in METHODS:
        raise ValueError("method")
    if call["method"] == "trame.trigger" and call["args"][0] not in TRIGGERS:
        raise ValueError("trigger")
    if call["method"] not in IGNORED:
        return data
    # The page waits for an answer to these calls, but it may change neither the state nor the server.
    body = msgpack.packb({**call, "args": [IGNORED[call["method"]]], "kwargs": {}})
    return _HEADER.pack(0, 0, len(body)) + bytes(body)
