"""Files that are dropped on a page: received into a temporary folder, with a limit, and opened from there."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.settings.budgets import UPLOAD
from accelsurf.viewer.actions.opening import Opening
from accelsurf.viewer.actions.tool import short
from accelsurf.viewer.page.guard import PageGuard

#: Bytes of the longest name; bytes that are received at once.
MAX_NAME, BLOCK = 200, 1 << 18


class PageUploads:
    """Receives files, one at a time, and opens each.

    Parameters
    ----------
    folder : Path
        An empty folder; each file has one of its own in it.
    guard : PageGuard
        Knows the token.
    opening : Opening
    """

    def __init__(self, folder: Path, guard: PageGuard, opening: Opening) -> None:
        self._folder, self._guard, self._opening = folder, guard, opening
        self._count, self._is_receiving = 0, False
        #: What was received and is still needed, by the folder of each.
        self._received: dict[Path, Path] = {}

    def install(self, server: Any) -> None:
        """Add the address for uploads to a server, before it listens."""
        server.app.router.add_post("/upload", self._upload)

    def discard(self, used: Path | None) -> None:
        """Delete what was received, but for the file that is in use."""
        for home, path in list(self._received.items()):
            if path != used:
                del self._received[home]
                shutil.rmtree(home, ignore_errors=True)

    async def _upload(self, request: Any) -> Any:
        """Receive a file; what is wrong with it is said in the page, too."""
        from aiohttp import web

        if not self._guard.has_token(request):
            return web.Response(status=403, text="the token is not right")
        try:
            path = await self._receive(request)
            self._opening.open_path(path, dropped=True, temporary=True)
        except AccelsurfError as error:
            self._opening.refuse(f"{error.message} ({error.hint})" if error.hint else error.message)
            # The rest of what is sent is not read.
            return web.Response(status=413 if isinstance(error, InputError) else 400, text=error.message)
        return web.Response(text="received")

    async def _receive(self, request: Any) -> Path:
        """Write what is sent into a file of a new folder."""
        name = _checked_name(request.query.get("name", ""))
        if self._is_receiving or self._opening.is_busy:
            raise UsageError("something else is being opened", "wait until it is open")
        UPLOAD.check(request.content_length or 0, name)
        free = shutil.disk_usage(self._folder).free
        if (request.content_length or 0) > free // 2:
            raise InputError(f"{name}: there is no space for it on the disk of the server", "open it from the folder")
        self._count += 1
        home = self._folder / str(self._count)
        home.mkdir()
        self._is_receiving = True
        try:
            self._opening.say(f"receiving {name} ...")
            await _write(request, home / name, min(UPLOAD.limit, free // 2))
        except BaseException:
            shutil.rmtree(home, ignore_errors=True)
            raise
        finally:
            self._is_receiving = False
        self._received[home] = home / name
        return home / name


async def _write(request: Any, path: Path, limit: int) -> None:
    """Write the body of a request into a file, no more than a limit, whatever its header says."""
    received = 0
    try:
        with path.open("xb") as file:
            async for block in request.content.iter_chunked(BLOCK):
                received += len(block)
                UPLOAD.check(received, path.name)
                if received > limit:
                    raise InputError(f"{path.name}: there is no space for it on the disk of the server")
                file.write(block)
    except OSError as error:  # the connection was lost, or the disk is full
        raise InputError(f"{path.name}: was not received ({error.strerror or 'the connection was lost'})") from None
    if received != (request.content_length if request.content_length is not None else received):
        raise InputError(f"{path.name}: was received in part only", "drop it again")


def _checked_name(name: str) -> str:
    """The name of a file and nothing else.

    Raises
    ------
    UsageError
        When it is none.
    """
    try:
        size = len(name.encode())
    except UnicodeEncodeError:
        size = 0
    is_plain = 0 < size <= MAX_NAME and name.isprintable() and not set(name) & set('/\\:*?"<>|')
    if not is_plain or name.startswith(".") or Path(name).name != name:
        raise UsageError(f"{short(name)}: is no name of a file", "rename it")
    return name
