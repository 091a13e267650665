"""``accelsurf serve``: viewers click, this machine answers."""

from __future__ import annotations

import os
from typing import Annotated

from cyclopts import Parameter

from accelsurf.cases import Interrupts, default_handling
from accelsurf.errors import UsageError
from accelsurf.serve import Log

#: Packages of the extra ``serve``.
_INSTALL = 'pip install "accelsurf[serve]"'
#: Where clients of the protocol look for the key, too.
_KEY = "NN_INTERACTIVE_API_KEY"


def serve(
    *,
    host: str = "127.0.0.1",
    port: int = 1527,
    api_key: Annotated[
        str | None, Parameter(show_default=f"the environment's {_KEY}, if set")
    ] = None,
    max_sessions: int = 2,
    idle_timeout: float = 600.0,
) -> int:
    """Answer the clicks of viewers that speak nnInteractive's protocol: 3D Slicer, napari and others.

    Start it, and give the viewer's plug-in the address that is printed, in place of an nnInteractive server's: point,
    box in a slice, scribble, lasso, a mask to begin with, undo. No GPU is needed, and nothing is written to disk.
    Each viewer that comes or goes, and each request with its outcome, is a line on standard error. Ctrl-C ends it.

    By default this machine alone is served. Nothing is encrypted: for other machines use a tunnel (ssh -L), or a
    network that you trust and a key.

    Parameters
    ----------
    host
        Address to listen on. Another one than this machine's needs a key.
    port
        Port to listen on; 0 for a free one.
    api_key
        Key that viewers must send, 16 characters at least.
    max_sessions
        Viewers at the same time. Each has an image in memory, of about 30 bytes for a voxel.
    idle_timeout
        Seconds without a prompt after which a viewer's place is free again.
    """
    import importlib.util

    missing = [
        name
        for name in ("starlette", "uvicorn", "blosc2")
        if importlib.util.find_spec(name) is None
    ]
    if missing:
        raise UsageError(f"serve: {', '.join(missing)} is not installed", _INSTALL)
    key = os.environ.get(_KEY) or None if api_key is None else api_key
    if key is not None and len(key) < 16:
        raise UsageError(
            "api_key: a key of less than 16 characters was given", "give a long random one"
        )
    if not 1 <= max_sessions <= 64:
        raise UsageError(f"max_sessions: {max_sessions} was given, expected 1 to 64")
    if not 1 <= idle_timeout <= 1e6:
        raise UsageError(f"idle_timeout: {idle_timeout:g} was given, expected 1 to 1000000 seconds")
    if not 0 <= port <= 65535:
        raise UsageError(f"port: {port} was given, expected 0 to 65535")
    from accelsurf.serve import Limits
    from accelsurf.serve import serve as listen

    def show(address: str) -> None:
        print(f"{address}\nCtrl-C ends it", flush=True)

    Interrupts.current().note("the server has ended")
    log = Log()
    with default_handling():
        try:
            listen(host, port, Limits(max_sessions, idle_timeout), key, show, log.write)
        except KeyboardInterrupt:  # the documented way to end it
            pass
    log.close()
    return 0
