"""Listening: the server on its address until Ctrl-C."""

from __future__ import annotations

import socket
from asyncio import BaseTransport, Transport
from collections.abc import Callable
from typing import cast

import numpy as np
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

import accelsurf
from accelsurf.errors import OutputError, UsageError
from accelsurf.serve.app import LOCAL, MAX_JSON, Limits, Server

#: Connections at once, and seconds in which one must send its first headers, or may stay without a request.
MAX_CONNECTIONS = 64
IDLE = 30


class _Protocol(H11Protocol):
    """HTTP/1.1; a connection that asks nothing is closed, which uvicorn does only after a first request."""

    def connection_made(self, transport: BaseTransport) -> None:
        super().connection_made(cast("Transport", transport))
        self.loop.call_later(IDLE, self._close_unless_asked)

    def _close_unless_asked(self) -> None:
        if not self.cycle:
            self.transport.close()


class _Listener(uvicorn.Server):
    """uvicorn's loop; when it ends, who waits for an answer gets a line, not a connection that breaks."""

    def __init__(self, config: uvicorn.Config, server: Server) -> None:
        super().__init__(config)
        self._server = server

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._server.end()
        await super().shutdown(sockets)


def serve(
    host: str,
    port: int,
    limits: Limits,
    key: str | None = None,
    on_ready: Callable[[str], None] | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> None:
    """Serve until Ctrl-C.

    Parameters
    ----------
    host : str
        Address to listen on.
    port : int
        0 for a free one.
    limits : Limits
    key : str, optional
        Whoever asks must know it.
    on_ready : callable, optional
        Called with the address, once it is listened on and compiled code is in memory.
    log : callable, optional
        As of `Server`.

    Raises
    ------
    UsageError
        When the host is not this machine and there is no key.
    OutputError
        When the address cannot be listened on.
    """
    is_local = host in LOCAL
    if not is_local and key is None:
        raise UsageError(
            f"host: {host} was given without a key, but other machines can reach it",
            "give a long random --api-key",
        )
    server = Server(limits, key, LOCAL if is_local else None, log)
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listening = socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"{host}:{port}: cannot be listened on ({reason})", "take another --port"
        ) from None
    with listening:
        warm_up()
        config = uvicorn.Config(
            server.app(),
            http=_Protocol,
            ws="none",
            lifespan="on",
            log_level="warning",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_keep_alive=IDLE,
            limit_concurrency=MAX_CONNECTIONS,
            h11_max_incomplete_event_size=2 * MAX_JSON,
            timeout_graceful_shutdown=1,
        )
        if on_ready is not None:
            name = f"[{host}]" if ":" in host else host
            on_ready(f"http://{name}:{listening.getsockname()[1]}")
        _Listener(config, server).run(sockets=[listening])


def warm_up() -> None:
    """Click into a small image, and correct it: compiled code and networks are then in memory."""
    places = (np.indices((24, 24, 24)) - 11.5) ** 2
    object = accelsurf.Interaction(np.asarray(places.sum(axis=0) < 64, np.float32))
    inside, wrong = (slice(8, 12),) * 3, (slice(13, 16),) * 3
    object.add(inside=accelsurf.Click("inside", inside, np.ones((4, 4, 4), np.bool_)))
    object.add(outside=accelsurf.Click("outside", wrong, np.ones((3, 3, 3), np.bool_)))
