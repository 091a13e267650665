"""How many connections a page's server keeps, and for how long one that has not given the token."""

from __future__ import annotations

import time
from dataclasses import dataclass
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

        def connection_made(protocol: Any, transport: Any) -> None:
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
            self._close(next((peer for peer, one in self.connections.items() if not one.trusted), _peer(transport)))

    def requested(self, transport: Any) -> None:
        """Note that a request came over a connection."""
        one = self.connections.get(_peer(transport))
        if one is not None:
            one.since = time.monotonic()

    def trust(self, transport: Any) -> None:
        """Note that a connection gave the token."""
        one = self.connections.get(_peer(transport))
        if one is not None:
            one.trusted = True

    def close_idle(self) -> None:
        """Close the connections that were idle for too long."""
        latest = time.monotonic() - MAX_IDLE
        for peer in [peer for peer, one in self.connections.items() if not one.trusted and one.since < latest]:
            self._close(peer)

    def _close(self, peer: Any) -> None:
        self.connections.pop(peer).transport.abort()


def _peer(transport: Any) -> Any:
    """Address and port of the other end."""
    return transport.get_extra_info("peername")
