"""The page's server, as the command starts it: requests without the token get a line and print nothing; its end."""

import contextlib
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from urllib.parse import urlsplit

import pytest

pytest.importorskip("trame", reason="the extra viewer is not installed")
pytestmark = [pytest.mark.program, pytest.mark.timeout(300)]


@contextlib.contextmanager
def served(folder):
    """The process and where it listens; the folder is its home."""
    process = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", "view", "--browser", "--no-open"],
        cwd=folder,
        env={**os.environ, "XDG_STATE_HOME": str(folder / "state")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        line = process.stdout.readline().strip()
        if not line.startswith("http://127.0.0.1:"):
            said = line + process.communicate(timeout=60)[0]
            if "error" in said and "draw" in said:
                pytest.skip("nothing can be drawn here")
            pytest.fail(said)
        yield process, urlsplit(line).port
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def answered(port, content):
    """Status and text of the answer to some bytes; no status for bytes after which more may come."""
    with socket.create_connection(("127.0.0.1", port), timeout=3) as connection:
        # It may hang up while this is sent.
        with contextlib.suppress(ConnectionError, TimeoutError):
            connection.sendall(content)
        found, length = b"", None
        with contextlib.suppress(ConnectionError, TimeoutError):
            while length is None or len(found) < length:
                if not (part := connection.recv(65536)):
                    break
                found += part
                if b"\r\n\r\n" in found and length is None:
                    said = re.search(rb"(?i)content-length: (\d+)", found)
                    length = found.index(b"\r\n\r\n") + 4 + int(said[1] if said else 0)
    head, _, text = found.partition(b"\r\n\r\n")
    return int(head.split()[1]) if head else None, text.decode(errors="replace")


def requests(port, seed):
    """Requests of all sizes, methods and addresses, drawn; none has the token."""
    drawn = random.Random(seed)
    host = f"Host: 127.0.0.1:{port}\r\n"

    def of(method="GET", path="/none", headers="", body=""):
        return f"{method} {path} HTTP/1.1\r\n{host}{headers}\r\n{body}".encode("latin-1")

    for length in (300, 1000, 8000, 8190, 9000, 20000, 200_000):
        length += drawn.randrange(99)
        yield of(headers=f"X-Long: {'a' * length}\r\n")
        yield of(headers=f"{'A' * length}: a\r\n")
        yield of(path="/" + "a" * length)
        yield of(path="/files/" + "a" * length)
        yield of(path="/x?secret=" + "0" * length)
        yield of(headers=f"Cookie: {'c=d; ' * (length // 5)}\r\n")
    yield of(headers="".join(f"X-{n}: a\r\n" for n in range(drawn.randrange(900, 3000))))
    upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\n"
    for method in ("GET", "POST", "PUT", "HEAD"):
        for headers in (
            "",
            "Upgrade: websocket\r\n",
            upgrade,
            upgrade + "Sec-WebSocket-Version: 13\r\n",
            upgrade + "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: short\r\n",
            upgrade
            + "Sec-WebSocket-Version: 99\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n",
        ):
            yield of(method, "/ws", headers)
    for method in ("BREW", "DELETE", "TRACE", "get", ""):
        yield of(method, drawn.choice(("/none", "/files/x", "/ws")))
    for path in (
        "/%00",
        "/%ff%fe",
        "/../../etc/passwd",
        "/%2e%2e/x",
        "/files/a?secret=%ff%00",
        "*",
    ):
        yield of(path=path)
    yield of("POST", "/none", "Content-Length: -5\r\n")
    yield of("POST", "/none", "Content-Length: 5\r\nContent-Length: 6\r\n", "abcdef")
    yield of("POST", "/none", "Transfer-Encoding: chunked\r\n", "zz\r\n")
    yield b"GET /none HTTP/1.1\r\n\r\n"
    yield b"GET /none HTTP/9.9\r\n" + host.encode() + b"\r\n"
    for _ in range(20):
        yield drawn.randbytes(drawn.randrange(1, 3000)) + b"\r\n\r\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_nobody_may_ask_gets_a_line_and_prints_nothing(tmp_path, number):
    with served(tmp_path) as (process, port):
        for content in requests(port, int(number)):
            status, text = answered(port, content)
            assert status is None or 400 <= status < 500, (content[:300], status, text)
            assert "Traceback" not in text and len(text) < 300, text
        assert answered(
            port, f"GET /index.html HTTP/1.0\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
        )[0] in (200, 403)
        began = time.monotonic()
        os.killpg(process.pid, number)
        said = process.stdout.read().splitlines()
        process.wait(60)
        assert time.monotonic() - began < 20
        # Ctrl-C is the way to end it.
        end = [] if number == signal.SIGINT else ["interrupted: nothing was unsaved"]
        assert said == ["Ctrl-C ends it", *end]
        assert process.returncode == (0 if number == signal.SIGINT else 143)
