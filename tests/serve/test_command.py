"""``accelsurf serve``: what is refused before anything is served, and how it ends."""

import signal
import socket
from urllib.request import urlopen

import pytest

from accelsurf.cli import execute
from tests.serve.conftest import started

pytest.importorskip("accelsurf.serve.listening", reason="the extra serve is not installed")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--host", "0.0.0.0"], "host: 0.0.0.0 was given without a key"),
        (["--api-key", "short"], "less than 16 characters"),
        (["--max-sessions", "0"], "max_sessions: 0 was given"),
        (["--idle-timeout", "0"], "idle_timeout: 0 was given"),
        (["--port", "99999"], "port: 99999 was given"),
    ],
)
def test_what_cannot_be_served_is_refused(options, line, capsys, monkeypatch):
    monkeypatch.delenv("NN_INTERACTIVE_API_KEY", raising=False)
    assert execute(["serve", *options]) == 2
    assert line in capsys.readouterr().err


def test_a_port_that_is_taken_is_named(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert execute(["serve", "--port", str(port)]) == 7
    assert f"127.0.0.1:{port}: cannot be listened on" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("number", "said", "code"),
    [
        (signal.SIGINT, "", 0),
        (signal.SIGTERM, "interrupted: the server has ended\n", 128 + signal.SIGTERM),
    ],
)
def test_ctrl_c_ends_it_without_a_fault(tmp_path, number, said, code):
    running = started(tmp_path)
    with urlopen(f"{running.address}/healthz", timeout=60) as answer:  # it has begun to serve
        assert answer.read() == b'{"ok":true}'
    running.process.send_signal(number)
    with running.process as process:
        assert process.stdout.read() == "Ctrl-C ends it\n" + said
    assert process.returncode == code
