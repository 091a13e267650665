"""Several viewers at once: slow ones hold nobody up, a lease that ends gives its memory back, an end is answered."""

import gc
import json
import random
import re
import signal
import socket
import threading
import time
import tracemalloc
import weakref
from contextlib import ExitStack
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from tests.serve.conftest import KEY, started

pytestmark = pytest.mark.program

arrays = pytest.importorskip("accelsurf.serve.arrays", reason="the extra serve is not installed")
httpx = pytest.importorskip("httpx")

IMAGE = np.random.default_rng(0).normal(0, 1, (1, 20, 21, 22)).astype(np.float32)
IMAGE[0, 5:15, 5:15, 5:15] += 20
POINT = {"coordinates": [10, 10, 10], "include_interaction": True}
SLOW_PATHS = (
    "set_image",
    "add_scribble_interaction",
    "add_lasso_interaction",
    "add_initial_seg_interaction",
    "add_point_interaction",
)


class Viewer:
    """A viewer with a place of its own."""

    def __init__(self, server, key=KEY):
        self.server = server
        self.client = httpx.Client(base_url=server.address, timeout=60)
        self.headers = {"Authorization": f"Bearer {key}"}
        self.headers["X-Lease-Token"] = self.post("claim").json()["lease_token"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.post("release")
        self.client.close()

    def post(self, path, **options):
        return self.client.post(f"/{path}", headers=self.headers, **options)

    def send(self, image=IMAGE):
        return self.post("set_image", content=arrays.pack(image)).raise_for_status()

    def begin(self, path, length, sent=b"NNIA"):
        """A request whose body has begun, and does not go on."""
        where = urlsplit(self.server.address)
        slow = socket.create_connection((where.hostname, where.port), timeout=30)
        meta = json.dumps({"include_interaction": True})
        lines = [f"{name}: {value}" for name, value in self.headers.items()]
        lines += ["Host: localhost", f"Content-Length: {length}", f"X-Meta: {meta}"]
        head = f"POST /{path} HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\n"
        slow.sendall(head.encode() + sent)
        return slow


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """A server with room for several viewers."""
    running = started(tmp_path_factory.mktemp("wide"), "--api-key", KEY, "--max-sessions", "8")
    yield running
    running.process.kill()
    running.process.communicate()


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("shared", [False, True], ids=["each a place", "one place"])
def test_slow_bodies_hold_nobody_up(wide, count, shared):
    drawn = random.Random(10 * count + shared)
    with ExitStack() as stack:
        slow = [stack.enter_context(Viewer(wide)) for _ in range(1 if shared else count)]
        for viewer in slow:
            viewer.send()
        for number in range(count):
            connection = slow[number % len(slow)].begin(
                drawn.choice(SLOW_PATHS),
                drawn.randrange(5000, 60000),
                b"N" * drawn.randrange(1, 99),
            )
            stack.enter_context(connection)
        time.sleep(0.3)
        with Viewer(wide) as quick:
            began = time.monotonic()
            quick.send()
            answer = quick.post("add_point_interaction", json=POINT)
            assert answer.status_code == 200 and json.loads(answer.headers["X-Meta"])["bbox"]
            mask = arrays.pack(np.ones((1, 3, 3), np.uint8))
            meta = {
                "X-Meta": json.dumps(
                    {
                        "include_interaction": False,
                        "interaction_bbox": [[1, 2], [1, 4], [1, 4]],
                    }
                )
            }
            quick.client.post(
                "/add_scribble_interaction", headers=quick.headers | meta, content=mask
            ).raise_for_status()
            assert time.monotonic() - began < 30  # not the 120 seconds that a body has


def test_an_array_that_is_sent_anew_takes_the_place_of_the_one_that_does_not_arrive(wide):
    with Viewer(wide) as viewer, viewer.begin("set_image", 10**6) as slow:
        time.sleep(0.3)
        viewer.send()
        assert slow.recv(12) == b"HTTP/1.1 409"


# ------------------------------------------------------------------------------------------------------------ memory


@pytest.fixture
def unbound():
    """The server's parts, without a socket: its application is asked in this process."""
    app = pytest.importorskip("accelsurf.serve.app")
    lines = []
    return app.Server(app.Limits(3, 600.0), None, None, lines.append), lines


def asked(server, work):
    """Have requests made within one loop of events."""
    import asyncio

    async def all_of_it():
        transport = httpx.ASGITransport(app=server.app())
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await work(client)

    return asyncio.run(all_of_it())


@pytest.mark.parametrize("end", ["release", "no life", "no prompt", "another image"])
def test_what_a_lease_had_is_freed_when_it_ends(unbound, end, monkeypatch):
    server, lines = unbound
    clock = [1000.0]
    monkeypatch.setattr(server.leases, "clock", lambda: clock[0])
    image = np.zeros((1, 96, 96, 96), np.float32)
    image[0, 30:60, 30:60, 30:60] = 100.0

    async def work(client):
        headers = {"X-Lease-Token": (await client.post("/claim")).json()["lease_token"]}
        packed = arrays.pack(image)
        (await client.post("/set_image", content=packed, headers=headers)).raise_for_status()
        for at in ([45, 45, 45], [35, 45, 45]):
            point = {"coordinates": at, "include_interaction": True}
            (
                await client.post("/add_point_interaction", json=point, headers=headers)
            ).raise_for_status()
        session = weakref.ref(server.leases.peek(headers["X-Lease-Token"]).session)
        assert session() is not None
        if end == "release":
            await client.post("/release", headers=headers)
        elif end == "another image":
            small = arrays.pack(image[:, 26:36, 26:36, 26:36])
            (await client.post("/set_image", content=small, headers=headers)).raise_for_status()
        else:
            clock[0] += 61.0 if end == "no life" else 0.0
            if end == "no prompt":
                for _ in range(11):  # its heart beats
                    clock[0] += 59.0
                    await client.post("/heartbeat", headers=headers)
            server.leases.sweep()
        return session

    pytest.importorskip("accelsurf.serve.listening").warm_up()  # compiled code is not an image
    gc.collect()
    tracemalloc.start()
    try:
        session = asked(server, work)
        gc.collect()
        assert session() is None
        assert tracemalloc.get_traced_memory()[0] < image.nbytes  # of 8 times as much
    finally:
        tracemalloc.stop()
    if end != "another image":
        assert "gone" in lines[-1] or "gone" in lines[-2]


def test_an_image_whose_place_ended_while_it_was_read_is_not_kept(unbound, monkeypatch):
    server, _ = unbound
    made = []
    app = pytest.importorskip("accelsurf.serve.app")

    class Late(app.ImageSession):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(weakref.ref(self))
            for token in list(server.leases.held):
                server.leases.release(token)

    monkeypatch.setattr(app, "ImageSession", Late)

    async def work(client):
        headers = {"X-Lease-Token": (await client.post("/claim")).json()["lease_token"]}
        return await client.post("/set_image", content=arrays.pack(IMAGE), headers=headers)

    assert asked(server, work).status_code == 410
    gc.collect()
    assert len(made) == 1 and made[0]() is None


@pytest.mark.slow
def test_the_process_gives_memory_back(wide):
    process = psutil.Process(wide.process.pid)
    image = np.zeros((1, 160, 160, 160), np.float32)
    image[0, 60:100, 60:100, 60:100] = 100.0
    sizes = []
    for _ in range(4):
        with Viewer(wide) as viewer:
            viewer.send(image)
            viewer.post("add_point_interaction", json={**POINT, "coordinates": [80, 80, 80]})
        sizes.append(process.memory_info().rss)
    assert sizes[-1] < sizes[0] + image.nbytes


# ----------------------------------------------------------------------------------------------------------- the log


def test_who_comes_what_is_asked_and_what_came_of_it_is_a_line_each(unbound):
    server, lines = unbound

    async def work(client):
        token = (await client.post("/claim")).json()["lease_token"]
        headers = {"X-Lease-Token": token}
        await client.post("/set_image", content=arrays.pack(IMAGE), headers=headers)
        await client.post("/add_point_interaction", json=POINT, headers=headers)
        await client.post("/heartbeat", headers=headers)
        await client.get("/healthz")
        wrong = {"coordinates": "\x1b[2J\n" * 99, "include_interaction": True}
        await client.post("/add_point_interaction", json=wrong, headers=headers)
        await client.post("/undo", headers={"X-Lease-Token": "\x1b none"})
        await client.post("/release", headers=headers)
        return token

    token = asked(server, work)
    times = [re.sub(r"\d\d:\d\d:\d\d |, \d+\.\d\d s$", "", line) for line in lines]
    assert times[0].endswith("without a place: claim: viewer 1 has come")
    assert times[1] == "viewer 1: set image: 1 x 20 x 21 x 22 voxels"
    assert re.fullmatch(
        r"viewer 1: add point: inside, \d+ voxels in the \d+ x \d+ x \d+ that have changed",
        times[2],
    )
    assert times[3].startswith("viewer 1: add point: 400, coordinates")
    assert "without a place: undo: 410, the lease is unknown" in times[4]
    assert times[5] == "viewer 1: gone (it has left)"
    assert len(lines) == 7 and all(line.isprintable() and len(line) < 400 for line in lines)
    assert token not in "".join(lines)


def test_a_log_that_nobody_reads_holds_nobody_up(tmp_path):
    running = started(tmp_path)  # into a pipe that is not read
    try:
        with httpx.Client(base_url=running.address, timeout=30) as client:
            for _ in range(1500):
                assert client.post("/undo").status_code == 410
    finally:
        running.process.send_signal(signal.SIGINT)
        running.process.communicate(timeout=30)


# ----------------------------------------------------------------------------------------------------------- the end


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("at", ["a click", "an image that arrives"])
def test_an_end_is_answered_in_a_line(tmp_path, number, at):
    running = started(tmp_path, "--api-key", KEY)
    viewer = Viewer(running)
    answers = []
    if at == "a click":
        # The worker has much to do: the answer cannot be there before the signal.
        image = np.random.default_rng(1).normal(0, 1, (1, 200, 200, 200)).astype(np.float32)
        viewer.send(image)

        def click():
            answers.append(viewer.post("add_point_interaction", json=POINT))

        asking = threading.Thread(target=click)
        asking.start()
        time.sleep(0.02)
    else:
        slow = viewer.begin("set_image", 10**6)
        time.sleep(0.5)
    running.process.send_signal(number)
    said = running.process.communicate(timeout=60)[0]
    assert "Traceback" not in said and "Exception" not in said and "Cancel" not in said, said
    assert running.process.returncode == (0 if number == signal.SIGINT else 143)
    if at == "a click":
        asking.join(30)
        assert answers[0].status_code in (200, 503)
        assert answers[0].status_code == 200 or "the server is ending" in answers[0].text
    else:
        assert slow.recv(12) == b"HTTP/1.1 503"
        slow.close()
    viewer.client.close()
