"""Requests that no viewer would send: each gets one line, nothing else happens, and the server goes on."""

import json
import socket
import struct
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from tests.serve.conftest import KEY

pytestmark = pytest.mark.program

arrays = pytest.importorskip("accelsurf.serve.arrays", reason="the extra serve is not installed")
httpx = pytest.importorskip("httpx")

#: Answers to what is wrong; 500 would be a fault of the server.
REFUSED = {400, 401, 403, 404, 405, 410, 413, 431, 503}
#: Bytes by which the server may grow while it refuses.
MAX_GROWTH = 400 << 20
JSON_PATHS = (
    *(
        "set_target_buffer",
        "set_do_autozoom",
        "add_point_interaction",
        "add_bbox_interaction",
        "undo",
        "predict",
    ),
)
ARRAY_PATHS = (
    "set_image",
    "add_scribble_interaction",
    "add_lasso_interaction",
    "add_initial_seg_interaction",
)
#: Values where a number, a list or a truth is expected.
ODD = (
    None,
    True,
    -1,
    0,
    1e300,
    -1e-300,
    10**30,
    10**400,
    "7",
    "x" * 500,
    [],
    {},
    [[]],
    [1, 2],
    [[1, 2]],
    [1, 2, 3, 4],
    [1e9, 0, 0],
    [-1, 0, 0],
    [[0, 0], [0, 1], [0, 1]],
    [[5, 1], [0, 1], [0, 1]],
    [[0, 99], [0, 99], [0, 99]],
    [[0, 1 << 31], [0, 1], [0, 1]],
    {"spacing": [0, 1, 1]},
    {"spacing": [1e9, 1e-9, 1]},
    {"spacing": ["a", 1, 1]},
    {"spacing": [1] * 99},
    float("nan"),
    float("inf"),
    [float("nan")] * 3,
)
KEYS = (
    "coordinates",
    "bbox_coords",
    "include_interaction",
    "run_prediction",
    "interaction_bbox",
    "image_properties",
    "shape",
    "dtype",
    "do_autozoom",
)


def text(random):
    """JSON, or nearly so."""
    kind = random.integers(8)
    if kind == 0:
        return "[" * int(random.integers(1, 20000))
    if kind == 1:
        return bytes(random.integers(33, 127, 200, dtype=np.uint8)).decode()
    said = {key: ODD[random.integers(len(ODD))] for key in KEYS if random.random() < 0.5}
    if random.random() < 0.7:
        said |= {"include_interaction": True, "coordinates": [3, 3, 3], "interaction_bbox": None}
        said |= {key: ODD[random.integers(len(ODD))] for key in random.choice(KEYS, 1)}
    return json.dumps(said)


def array(random):
    """An array of a wrong shape or type, or without an object."""
    shapes = (
        (1, 8, 9, 10),
        (8, 9, 10),
        (1, 1, 1, 1),
        (3, 2, 2, 2),
        (40, 1, 1, 1),
        (9,),
        (2, 1 << 16),
    )
    shape = shapes[random.integers(len(shapes))]
    dtype = ("uint8", "float32", "float64", "bool", "int64", "float16")[random.integers(6)]
    values = random.normal(0, 1, shape) * 10.0 ** int(random.integers(-3, 4))
    if random.random() < 0.3:
        values[...] = (0.0, np.nan, np.inf, 1.0)[random.integers(4)]
    with np.errstate(all="ignore"):
        return values.astype(dtype)


def bomb():
    """A short frame that claims 2 GB of zeros, as blosc2 itself writes it."""
    import blosc2

    size = (1 << 31) - 64
    frame = bytearray(blosc2.compress2(np.zeros(1 << 20, np.uint8), codec=blosc2.Codec.LZ4))
    frame[4:8] = struct.pack("<I", size)
    header = struct.pack("<4sBBBB5s4qI", b"NNIA", 1, 2, 4, 5, b"uint8", 1, size, 1, 1, 1)
    return header + struct.pack("<QQ", size, len(frame)) + bytes(frame)


def body(random):
    """A packed array, damaged or not, or anything."""
    kind = random.integers(6)
    if kind == 0:
        return bytes(random.integers(0, 256, int(random.integers(0, 5000)), dtype=np.uint8))
    if kind == 1:
        return bomb()
    out = bytearray(arrays.pack(array(random)))
    if kind == 2:
        return bytes(out)
    for _ in range(int(random.integers(1, 5))):
        first = int(random.integers(len(out) if random.random() < 0.5 else min(len(out), 90)))
        word = struct.pack("<I", (0, 1, 255, 1 << 20, 1 << 31, (1 << 32) - 1)[random.integers(6)])
        out[first : first + 4] = (
            word if random.random() < 0.6 else bytes([int(random.integers(256))])
        )
    return bytes(out[: int(random.integers(1, len(out)))] if random.random() < 0.2 else out)


def request(random, token):
    """Method, path, headers and content."""
    headers = {"Authorization": f"Bearer {KEY}", "X-Lease-Token": token}
    if random.random() < 0.1:
        headers["X-Lease-Token"] = ("", "x", "0" * 9000, token[:-1])[random.integers(4)]
    if random.random() < 0.1:
        headers["Authorization"] = ("", KEY, "Basic a", "Bearer", f"Bearer {KEY}0")[
            random.integers(5)
        ]
    if random.random() < 0.05:
        headers |= ({"Host": "example.org"}, {"Origin": "http://example.org"})[random.integers(2)]
    if random.random() < 0.1:
        path = ("", "claim/..", "../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "set_image/x", "\\")[
            random.integers(6)
        ]
        return ("GET", "PUT", "DELETE", "POST")[random.integers(4)], path, headers, body(random)
    if random.random() < 0.4:
        path = JSON_PATHS[random.integers(len(JSON_PATHS))]
        return "POST", path, headers, text(random).encode() * (200 if random.random() < 0.03 else 1)
    headers["X-Meta"] = text(random)
    return "POST", ARRAY_PATHS[random.integers(len(ARRAY_PATHS))], headers, body(random)


def raw(server, content):
    """Send bytes that are no request, and leave."""
    where = urlsplit(server.address)
    with socket.create_connection((where.hostname, where.port), timeout=10) as connection:
        connection.sendall(content)


def play(server, seed, count):
    """Send so many requests; return the statuses."""
    random, memory = np.random.default_rng(seed), psutil.Process(server.process.pid)
    image = random.normal(0, 1, (1, 12, 13, 14)).astype(np.float32)
    found = []
    with httpx.Client(base_url=server.address, timeout=60) as client:
        headers = {"Authorization": f"Bearer {KEY}"}
        token = client.post("/claim", headers=headers).json()["lease_token"]
        headers["X-Lease-Token"] = token
        assert (
            client.post("/set_image", content=arrays.pack(image), headers=headers).status_code
            == 200
        )
        before, files = memory.memory_info().rss, server.files()
        for number in range(count):
            method, path, sent, content = request(random, token)
            try:
                answer = client.request(method, f"/{path}", headers=sent, content=content)
            except httpx.RemoteProtocolError:  # it was hung up on a header that is too long
                continue
            found.append(answer.status_code)
            assert answer.status_code in REFUSED | {200}, (
                number,
                path,
                sent,
                content[:200],
                answer.text,
            )
            if answer.status_code in REFUSED - {404, 405, 431}:
                detail = answer.json()["detail"]
                assert 0 < len(detail) < 1200 and "\n" not in detail and "Traceback" not in detail
            if number % 25 == 0:
                raw(server, bytes(random.integers(0, 256, 300, dtype=np.uint8)))
                raw(
                    server,
                    b"POST /set_image HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999999\r\n\r\nx",
                )
                assert memory.memory_info().rss < before + MAX_GROWTH
        assert memory.memory_info().rss < before + MAX_GROWTH
        assert server.files() == files
        # The same session still works.
        client.post("/set_image", content=arrays.pack(image), headers=headers).raise_for_status()
        point = {"coordinates": [6, 6, 6], "include_interaction": True}
        client.post("/add_point_interaction", json=point, headers=headers).raise_for_status()
        client.post("/release", headers=headers).raise_for_status()
    return found


def test_two_hundred_requests_that_no_viewer_would_send(server):
    found = play(server, 1, 200)
    assert {400, 401, 403, 404, 410, 413} <= set(found)  # the generator reaches all checks


@pytest.mark.slow
def test_a_thousand_more(server):
    assert len(play(server, 2, 1000)) > 900


def test_a_body_that_never_ends_is_cut_and_keeps_nobody_waiting(server):
    where = urlsplit(server.address)
    with httpx.Client(base_url=server.address, timeout=60) as client:
        headers = {"Authorization": f"Bearer {KEY}"}
        headers["X-Lease-Token"] = client.post("/claim", headers=headers).json()["lease_token"]
        with socket.create_connection((where.hostname, where.port), timeout=10) as slow:
            lines = [f"{name}: {value}" for name, value in headers.items()]
            lines += ["Host: localhost", "Content-Length: 1000000"]
            slow.sendall(
                ("POST /set_image HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\nNNIA").encode()
            )
            assert client.post("/heartbeat", headers=headers).status_code == 200
            without_image = client.post("/undo", headers=headers)
            assert (without_image.status_code, without_image.json()["detail"][:17]) == (
                400,
                "no image was sent",
            )
        long = client.post("/add_point_interaction", headers=headers, content=b"1" * (1 << 17))
        assert long.status_code == 400  # there is no image: nothing is read
        client.post(
            "/set_image",
            content=arrays.pack(np.random.default_rng(0).random((1, 8, 8, 8))),
            headers=headers,
        )
        long = client.post("/add_point_interaction", headers=headers, content=b"1" * (1 << 17))
        assert (long.status_code, "at most 65536" in long.text) == (413, True)
        client.post("/release", headers=headers)
