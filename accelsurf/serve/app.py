"""The server's endpoints: who may ask, the parts of a request that are read, and who works on it."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import psutil
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

import accelsurf
from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.serve import arrays
from accelsurf.serve.session import LIVENESS, FullError, ImageSession, Lease, LeaseLostError, Leases

#: Headers of the protocol: metadata of a request or an answer as JSON, and the lease.
META = "X-Meta"
LEASE = "X-Lease-Token"
#: Version of the protocol that is spoken.
PROTOCOL = "2.6"
#: Addresses of this machine alone.
LOCAL = ("127.0.0.1", "localhost", "::1")
#: Bytes of the longest body without an array, and of metadata.
MAX_JSON = 1 << 16
#: Bytes of an array for each byte of its voxels that a session and its work take: values as sent and as they are
#: evolved, the score map, labels.
COST = 8
#: Bytes of a voxel as it is counted: a channel is scaled to 32 bits.
VOXEL = 4
#: Parts of the memory that is free that an array may take, with its cost.
SHARE = 0.5
#: Voxels of the largest image.
MAX_VOXELS = 1 << 31
#: Seconds for a body to arrive, for a prompt and for an image to be worked on: the clients wait so long.
BODY_SECONDS = 120.0
PROMPT_SECONDS = 60.0
IMAGE_SECONDS = 600.0
#: Seconds in which the rest of a body is read away whose request is refused.
DISCARD_SECONDS = 30.0
#: Requests that wait for the one that works.
MAX_WAITING = 32
#: Requests that a program asks again and again: where they are answered, they are not in the log.
UNLOGGED = ("healthz", "capabilities", "lease_status", "heartbeat", "set_do_autozoom")
#: Letters of a line of the log.
MAX_LINE = 300
#: Key of a request's scope with its effect, for the log.
_DONE = "accelsurf.done"
#: Seconds between two looks for clients that are gone.
SWEEP = 5.0

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
Place = Annotated[int, Field(ge=0, le=1 << 31)]
Interval = tuple[Finite, Finite]
Range = tuple[Place, Place]
_log = logging.getLogger("accelsurf.serve")


class Message(BaseModel):
    """Message of a client; fields that are not listed are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Prompt(Message):
    """The part of a prompt that all kinds have."""

    include_interaction: bool
    run_prediction: bool = True

    @property
    def side(self) -> Literal["inside", "outside"]:
        """Inside or outside of the object."""
        return "inside" if self.include_interaction else "outside"


class PointPrompt(Prompt):
    """A point, an index of the image's array."""

    coordinates: tuple[Finite, Finite, Finite]


class RectanglePrompt(Prompt):
    """A rectangle: from, and to before, along each axis."""

    bbox_coords: tuple[Interval, Interval, Interval]


class MaskPrompt(Prompt):
    """The voxels of a stroke or a lasso, on a box."""

    interaction_bbox: tuple[Range, Range, Range] | None = None


class LabelsPrompt(Message):
    """Labels to begin at."""

    run_prediction: bool = False


class ImageProperties(Message):
    """Properties of an image, as far as a client names them."""

    spacing: Annotated[tuple[Finite, ...], Field(min_length=2, max_length=3)] | None = None


class ImageMeta(Message):
    """Metadata of an image."""

    image_properties: ImageProperties = ImageProperties()


class TargetBuffer(Message):
    """The array in which a client shows labels."""

    shape: tuple[Place, Place, Place]
    dtype: Annotated[str, Field(max_length=16)]


Said = TypeVar("Said", bound=Message)
Done = TypeVar("Done")


class Refusal(Exception):
    """A request that is refused, with its status and one line."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status, self.detail = status, detail


class LateError(Exception):
    """Work that took too long."""

    def __init__(self, seconds: float) -> None:
        super().__init__(seconds)
        self.seconds = seconds


class Limits(NamedTuple):
    """Limits of a server.

    Attributes
    ----------
    sessions : int
        Clients at once.
    idle : float
        Seconds without a prompt after which a client's place is free again.
    """

    sessions: int = 2
    idle: float = 600.0


class Server:
    """The server's state: leases, and the one worker.

    Parameters
    ----------
    limits : Limits
    key : str or None
        Whoever asks must know it; None for nobody.
    hosts : tuple of str or None
        Names under which the server may be asked; None for any.
    log : callable, optional
        Called with a line for each viewer that comes or goes, and for each request of a person; returns at once.
    """

    def __init__(
        self,
        limits: Limits,
        key: str | None = None,
        hosts: tuple[str, ...] | None = LOCAL,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        if key is not None and not key:
            raise UsageError(
                "api_key: an empty key was given", "leave it out, or give a long random one"
            )
        self.leases = Leases(limits.sessions, limits.idle, on_end=self._tell_end)
        self._write_log = log
        self._key, self._hosts = key, hosts
        self._worker = ThreadPoolExecutor(1, "accelsurf serve")
        self._waiting = 0
        #: Bytes of arrays in memory, as they were sent; and the time limit of each that arrives, by its lease.
        self._held = 0
        self._arriving: dict[str, asyncio.Timeout] = {}
        self._asked = set[asyncio.Task[Any]]()
        self._is_ending = False

    def app(self) -> Starlette:
        """Return the application."""
        routes = [
            ("/healthz", "GET", self._healthz),
            ("/capabilities", "GET", self._capabilities),
            ("/lease_status", "GET", self._lease_status),
            ("/claim", "POST", self._claim),
            ("/release", "POST", self._release),
            ("/heartbeat", "POST", self._heartbeat),
            ("/set_image", "POST", self._set_image),
            ("/set_target_buffer", "POST", self._set_target_buffer),
            ("/set_do_autozoom", "POST", self._set_do_autozoom),
            ("/predict", "POST", self._predict),
            ("/reset_interactions", "POST", self._reset),
            ("/undo", "POST", self._undo),
            ("/add_point_interaction", "POST", self._point),
            ("/add_bbox_interaction", "POST", self._rectangle),
            ("/add_scribble_interaction", "POST", self._scribble),
            ("/add_lasso_interaction", "POST", self._lasso),
            ("/add_initial_seg_interaction", "POST", self._labels),
        ]
        return Starlette(
            routes=[
                Route(path, self._answered(handler), methods=[method])
                for path, method, handler in routes
            ],
            lifespan=self._lifespan,
        )

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        async def sweep() -> None:
            while True:
                await asyncio.sleep(SWEEP)
                self.leases.sweep()

        sweeping = asyncio.create_task(sweep())
        try:
            yield
        finally:
            sweeping.cancel()
            self._worker.shutdown(wait=False, cancel_futures=True)

    # -- answers -------------------------------------------------------------------------------------------

    def _answered(
        self, handler: Callable[[Request], Awaitable[Response]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """Return a handler that is called for those who may ask, and answers errors with one line."""

        async def answer(request: Request) -> Response:
            began, task = time.perf_counter(), asyncio.current_task()
            assert task is not None
            self._asked.add(task)
            task.add_done_callback(self._asked.discard)
            try:
                self._check_caller(request)
                response = await handler(request)
                self._log(request, "", began)
                return response
            except asyncio.CancelledError:
                if not self._is_ending:
                    raise
                status, detail = 503, "the server is ending, and has not answered this"
            except Refusal as refusal:
                status, detail = refusal.status, refusal.detail
            except LeaseLostError:
                status, detail = 410, "the lease is unknown or has ended: claim a new one"
            except LateError as late:
                # The client may show another object than the session has.
                self.leases.release(request.headers.get(LEASE, ""), "its work took too long")
                status, detail = (
                    503,
                    f"the work took more than {late.seconds:g} seconds: the session has ended",
                )
            except FullError:
                status, detail = 503, f"all {self.leases.most} sessions are taken: try again later"
            except AccelsurfError as error:
                status = 413 if isinstance(error, arrays.TooLargeError) else 400
                detail = f"{error.message} ({error.hint})" if error.hint else error.message
            except MemoryError:
                status, detail = 413, "not enough memory: send a part of the image"
            except ClientDisconnect:
                status, detail = 400, "the request was not sent to its end"
            except Exception:
                _log.exception("%s", request.url.path)
                status, detail = (
                    500,
                    "internal error: the terminal of accelsurf serve has the traceback",
                )
            self._log(request, f"{status}, {detail}", began)
            is_read = not self._is_ending and await _discarded(request)
            return JSONResponse(
                {"detail": detail}, status, headers={} if is_read else {"Connection": "close"}
            )

        return answer

    def end(self) -> None:
        """Answer open requests with a line about the end: nothing is worked on any more."""
        self._is_ending = True
        for task in list(self._asked):
            task.cancel()

    # -- the log -------------------------------------------------------------------------------------------

    def _log(self, request: Request, error: str, began: float) -> None:
        """Note a request: its client, name and effect. Nothing of the image but sizes is noted, and no path."""
        what = request.url.path.removeprefix("/")
        if what in UNLOGGED and not error:
            return
        lease = self.leases.peek(request.headers.get(LEASE, ""))
        client = "" if request.client is None else request.client.host
        who = f"viewer {lease.number}" if lease is not None else f"{client}, without a place"
        came = error or request.scope.get(_DONE, "done")
        what = what.removesuffix("_interaction").replace("_", " ")
        self._tell(f"{who}: {what}: {came}, {time.perf_counter() - began:.2f} s")

    def _tell_end(self, lease: Lease, why: str) -> None:
        self._tell(f"viewer {lease.number}: gone ({why})")

    def _tell(self, line: str) -> None:
        shown = (part if part.isprintable() else ascii(part)[1:-1] for part in line[:MAX_LINE])
        self._write_log(f"{time.strftime('%H:%M:%S')} {''.join(shown)}")

    # -- who may ask ---------------------------------------------------------------------------------------

    def _check_caller(self, request: Request) -> None:
        """Refuse other sites' pages, names under which this server is not served, and those without the key."""
        host = request.headers.get("Host", "")
        name = host.rpartition(":")[0] if ":" in host.rpartition("]")[2] else host
        if self._hosts is not None and name.strip("[]") not in self._hosts:
            raise Refusal(403, "this server is not served under that name")
        if "Origin" in request.headers:
            raise Refusal(403, "this server answers no web pages")
        if self._key is None or request.url.path == "/healthz":
            return
        kind, _, given = request.headers.get("Authorization", "").partition(" ")
        if kind != "Bearer" or not hmac.compare_digest(given.strip().encode(), self._key.encode()):
            raise Refusal(401, "the API key is missing or wrong")

    def _lease(self, request: Request, *, by_person: bool = True) -> Lease:
        return self.leases.find(request.headers.get(LEASE, ""), by_person=by_person)

    def _session(self, request: Request) -> ImageSession:
        """Return the session of a request that a person has made."""
        session = self._lease(request).session
        if session is None:
            raise Refusal(400, "no image was sent yet: begin with set_image")
        return session

    # -- reading -------------------------------------------------------------------------------------------

    async def _body_parts(self, request: Request, most: int) -> AsyncIterator[bytes]:
        """Return a body of at most ``most`` bytes, part by part."""
        said = request.headers.get("Content-Length", "0")
        if said.isdecimal() and int(said[:20]) > most:
            raise Refusal(413, f"a body of {said[:20]} bytes was sent, at most {most} expected")
        count = 0
        async for part in request.stream():
            count += len(part)
            if count > most:
                raise Refusal(413, f"a body of more than {most} bytes was sent")
            yield part

    async def _json(self, request: Request, kind: type[Said]) -> Said:
        try:
            async with asyncio.timeout(BODY_SECONDS):
                parts = [part async for part in self._body_parts(request, MAX_JSON)]
        except TimeoutError:
            raise Refusal(408, f"the body did not arrive within {BODY_SECONDS:g} seconds") from None
        return _parsed(b"".join(parts), kind)

    async def _fill(self, body: bytearray, request: Request, most: int, room: int) -> None:
        """Read an array as it is sent, and count its bytes in memory.

        However slowly they arrive, arrays hold nobody up: each viewer sends one, and one that it sends anew takes the
        place of one that has not arrived.

        Parameters
        ----------
        body : bytearray
            Gets the bytes.
        request : Request
        most : int
            Bytes that it may have.
        room : int
            Bytes that all arrays may have together.
        """
        token, loop = request.headers.get(LEASE, ""), asyncio.get_running_loop()
        before, ends = self._arriving.get(token), loop.time() + BODY_SECONDS
        if before is not None and not before.expired():
            before.reschedule(loop.time())
        try:
            async with asyncio.timeout_at(ends) as limit:
                self._arriving[token] = limit
                async for part in self._body_parts(request, most):
                    body += part
                    self._held += len(part)
                    if self._held > room:
                        raise Refusal(503, "the arrays of other viewers fill the memory: try again")
        except TimeoutError:
            if loop.time() < ends:
                raise Refusal(409, "another array of this viewer has come in its place") from None
            raise Refusal(408, f"the body did not arrive within {BODY_SECONDS:g} seconds") from None
        finally:
            if self._arriving.get(token) is limit:
                del self._arriving[token]

    def _meta(self, request: Request, kind: type[Said]) -> Said:
        text = request.headers.get(META, "{}")
        if len(text) > MAX_JSON:
            raise Refusal(
                413, f"{META}: {len(text)} characters were sent, at most {MAX_JSON} expected"
            )
        return _parsed(text.encode(errors="replace"), kind)

    async def _with_array(
        self, request: Request, work: Callable[[Any], Done], max_voxels: int, seconds: float
    ) -> Done:
        """Read a packed array of at most ``max_voxels`` voxels, and let the worker do something with it."""
        free = int(SHARE * psutil.virtual_memory().available)
        # An array that cannot be packed is a little longer than its values.
        most = min(8 * max_voxels, free // 2)
        most += most // 64 + 1024
        body = bytearray()

        def unpack_and_work() -> Done:
            header = arrays.header_of(body)
            voxels = header.nbytes // header.dtype.itemsize
            if voxels > max_voxels:
                raise arrays.TooLargeError(
                    f"array: {voxels} voxels were sent, at most {max_voxels} expected"
                )
            if max(COST * VOXEL * voxels, header.nbytes) > free:
                raise arrays.TooLargeError(
                    f"array: {voxels} voxels were sent, too many for the memory here",
                    "send a part of the image",
                )
            return work(arrays.unpack(body, header.nbytes))

        try:
            await self._fill(body, request, most, max(most, free // 2 + self._held))
            return await self._worked(unpack_and_work, seconds)
        finally:
            self._held -= len(body)

    async def _worked(self, work: Callable[[], Done], seconds: float = PROMPT_SECONDS) -> Done:
        """Let the worker do something; it does one thing after the other."""
        if self._waiting >= MAX_WAITING:
            raise Refusal(503, "too many requests wait: try again later")
        self._waiting += 1
        task = asyncio.get_running_loop().run_in_executor(self._worker, work)
        try:
            return await asyncio.wait_for(task, seconds)
        except TimeoutError:
            raise LateError(seconds) from None
        finally:
            self._waiting -= 1

    # -- endpoints -----------------------------------------------------------------------------------------

    async def _healthz(self, _: Request) -> Response:
        return JSONResponse({"ok": True})

    async def _capabilities(self, _: Request) -> Response:
        return JSONResponse(
            {
                "supported_interactions": {
                    "points": True,
                    "bbox2d": True,
                    "bbox3d": False,
                    "scribble": True,
                    "lasso": True,
                },
                "supports_initial_label": True,
                "supports_zero_shot_label_refinement": False,
                "supports_undo": True,
                "do_autozoom": False,
                "channel_mapping": {},
                "num_interaction_channels": 0,
                "preferred_scribble_thickness": [2, 2, 2],
                "interaction_decay": None,
                "patch_size": None,
                "inference_session_version": PROTOCOL,
                "license": "BSD-3-Clause",
                "server": f"accelsurf {accelsurf.__version__}",
            }
        )

    async def _claim(self, request: Request) -> Response:
        token = self.leases.claim()
        request.scope[_DONE] = f"viewer {self.leases.find(token).number} has come"
        return JSONResponse(
            {
                "lease_token": token,
                "idle_timeout_seconds": self.leases.idle,
                "liveness_timeout_seconds": LIVENESS,
                "max_sessions": self.leases.most,
            }
        )

    async def _release(self, request: Request) -> Response:
        self.leases.release(request.headers.get(LEASE, ""), "it has left")
        return JSONResponse({"released": True})

    async def _heartbeat(self, request: Request) -> Response:
        self._lease(request, by_person=False)
        return await self._lease_status(request)

    async def _lease_status(self, request: Request) -> Response:
        remaining = self.leases.remaining(request.headers.get(LEASE, ""))
        return JSONResponse(
            {"remaining_seconds": remaining, "idle_timeout_seconds": self.leases.idle}
        )

    async def _set_image(self, request: Request) -> Response:
        self._lease(request)
        meta = self._meta(request, ImageMeta)
        spacing = meta.image_properties.spacing
        session = await self._with_array(
            request, lambda image: ImageSession(image, spacing), MAX_VOXELS, IMAGE_SECONDS
        )
        # Its time may have come meanwhile: then nobody would ever free the image.
        self._lease(request).open(session)
        sizes = " x ".join(map(str, session.shape))
        request.scope[_DONE] = f"{session.channels} x {sizes} voxels"
        return JSONResponse({"original_image_shape": [session.channels, *session.shape]})

    async def _set_target_buffer(self, request: Request) -> Response:
        session, buffer = self._session(request), await self._json(request, TargetBuffer)
        if buffer.shape != session.shape:
            raise Refusal(
                400,
                f"a buffer of shape {buffer.shape} was named, expected the image's {session.shape}",
            )
        if buffer.dtype not in arrays.TYPES or arrays.TYPES[buffer.dtype].kind not in "bui":
            raise Refusal(400, "a buffer of another type was named, expected integers or bool")
        return JSONResponse({})

    async def _set_do_autozoom(self, request: Request) -> Response:
        self._lease(request)
        return JSONResponse({"do_autozoom": False})  # there is nothing to zoom

    async def _predict(self, request: Request) -> Response:
        session = self._session(request)
        return await self._worked(lambda: _response(request, session, session.is_waiting))

    async def _reset(self, request: Request) -> Response:
        session = self._session(request)
        await self._worked(session.clear)
        return JSONResponse({})

    async def _undo(self, request: Request) -> Response:
        session = self._session(request)
        return await self._worked(lambda: _response(request, session, session.undo()))

    async def _point(self, request: Request) -> Response:
        session, said = self._session(request), await self._json(request, PointPrompt)

        def work() -> Response:
            session.point(said.coordinates, said.side)
            return _response(request, session, said.run_prediction, said.side)

        return await self._worked(work)

    async def _rectangle(self, request: Request) -> Response:
        session, said = self._session(request), await self._json(request, RectanglePrompt)

        def work() -> Response:
            session.rectangle(said.bbox_coords, said.side)
            return _response(request, session, said.run_prediction, said.side)

        return await self._worked(work)

    async def _scribble(self, request: Request) -> Response:
        return await self._masked(request, ImageSession.scribble)

    async def _lasso(self, request: Request) -> Response:
        return await self._masked(request, ImageSession.lasso)

    async def _masked(self, request: Request, add: Callable[..., None]) -> Response:
        session, said = self._session(request), self._meta(request, MaskPrompt)

        def work(mask: Any) -> Response:
            add(session, mask, said.interaction_bbox, said.side)
            return _response(request, session, said.run_prediction, said.side)

        return await self._with_array(request, work, session.size, PROMPT_SECONDS)

    async def _labels(self, request: Request) -> Response:
        session, said = self._session(request), self._meta(request, LabelsPrompt)

        def work(labels: Any) -> Response:
            session.start_from(labels)
            return _response(request, session, said.run_prediction)

        return await self._with_array(request, work, session.size, PROMPT_SECONDS)


async def _discarded(request: Request) -> bool:
    """Read the rest of a body away: a client that still sends would not see the answer. True if it came to its end."""
    try:
        async with asyncio.timeout(DISCARD_SECONDS):
            async for _ in request.stream():
                pass
    except RuntimeError:
        return True  # it was read to its end before
    except (TimeoutError, ClientDisconnect):
        return False
    return True


def _parsed(text: bytes, kind: type[Said]) -> Said:
    """Return a client's JSON as a ``kind``.

    Raises
    ------
    Refusal
        With the first thing that is wrong.
    """
    try:
        return kind.model_validate(json.loads(text))
    except (ValueError, RecursionError) as error:
        if not isinstance(error, ValidationError):
            raise Refusal(400, "a text was sent that is no JSON") from None
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part)[:40] for part in first["loc"][:4])
        raise Refusal(400, f"{where}: {first['msg'][:200]}".lstrip(": ")) from None


def _response(request: Request, session: ImageSession, is_asked: bool, side: str = "") -> Response:
    """Return the answer to a prompt: the part that has changed, if the client asks for it; and note it for the log."""
    answer = session.answer() if is_asked else None
    if answer is None:
        changed = "nothing has changed" if is_asked else "no answer is asked for"
    else:
        box = " x ".join(map(str, answer.labels.shape))
        changed = f"{np.count_nonzero(answer.labels)} voxels in the {box} that have changed"
    request.scope[_DONE] = f"{side}, {changed}".removeprefix(", ")
    meta: dict[str, Any] = {"ran_prediction": is_asked, "bbox": None}
    body = b""
    if answer is not None:
        meta["bbox"] = [[side.start, side.stop] for side in answer.box]
        meta |= {"dtype": "uint8", "shape": list(answer.labels.shape)}
        body = arrays.pack(answer.labels)
    return Response(
        body,
        media_type="application/octet-stream",
        headers={META: json.dumps(meta, separators=(",", ":"))},
    )
