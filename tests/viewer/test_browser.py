"""The page: served to whoever has the token and to nobody else, whatever is sent; driven by a real browser."""

import asyncio
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from accelsurf import cli, io
from accelsurf.viewer.page import guard
from accelsurf.viewer.page.guard import LOCAL, MAX_CONNECTIONS, MAX_IDLE, ConnectionLimit, PageGuard
from tests.support import viewing

pytestmark = pytest.mark.program

aiohttp = pytest.importorskip("aiohttp", reason='trame is missing: pip install "accelsurf[viewer]"')
msgpack = pytest.importorskip("msgpack", reason='trame is missing: pip install "accelsurf[viewer]"')
pytest.importorskip("trame", reason='trame is missing: pip install "accelsurf[viewer]"')


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


class Served:
    """`accelsurf view --browser` in a process of its own."""

    def __init__(self, folder, *options, scan=None):
        self.image, self.results = folder / "ball.nii.gz", folder / "results"
        volume, center = scan or viewing.ball_image()
        noise = np.random.default_rng(1).normal(0, 20, volume.array.shape)
        io.write(volume.with_array((volume.array + noise).astype(np.float32)), self.image)
        start = "ball:" + ",".join(f"{v:g}" for v in (*center, 5.0))
        command = [
            sys.executable,
            "-m",
            "accelsurf",
            "view",
            str(self.image),
            "--browser",
            "--no-open",
        ]
        command += ["--start", start, "--threads", "1", "--output", str(self.results), *options]
        env = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
        self.log = open(folder / "log", "w+")
        self.process = subprocess.Popen(
            command, env=env, stdout=subprocess.PIPE, stderr=self.log, text=True
        )
        self.address = self.process.stdout.readline().strip()
        assert self.address.startswith("http://"), self.log_text()
        parts = urlsplit(self.address)
        self.port, self.token = parts.port, parts.query.removeprefix("secret=")
        self.origin = f"http://127.0.0.1:{self.port}"

    def log_text(self):
        return Path(self.log.name).read_text()

    def close(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(30)
        finally:
            self.process.kill()
            self.process.wait()
            self.process.stdout.close()
            self.log.close()
        return self.process.returncode

    def memory_mb(self):
        return (
            int(
                re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{self.process.pid}/status").read_text())[
                    1
                ]
            )
            / 1024
        )


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    server = Served(tmp_path_factory.mktemp("served"))
    yield server
    assert server.process.poll() is None, server.log_text()
    assert server.close() == 0, server.log_text()
    assert "Traceback" not in server.log_text()


def packed(call):
    body = msgpack.packb(call)
    return struct.pack("<III", 7, 0, len(body)) + body


def call_of(method, *args, number=1):
    return {
        "wslink": "1.0",
        "id": f"rpc:test:{number}",
        "method": method,
        "args": list(args),
        "kwargs": {},
    }


def hello(token):
    return packed({**call_of("wslink.hello", {"secret": token}), "id": "system:test:0"})


async def _talk(served, messages, headers=None, last=None):
    """Send messages; return the answers of the next moments, unpacked, or those up to the answer to call ``last``."""
    answers = []
    async with aiohttp.ClientSession() as client:
        async with client.ws_connect(
            f"{served.origin}/ws", headers=headers or {}, max_msg_size=0
        ) as ws:
            for message in messages:
                if ws.closed:
                    break
                await (ws.send_str(message) if isinstance(message, str) else ws.send_bytes(message))
            ends = time.monotonic() + (
                0.4 if last is None else 30.0
            )  # an answer that is waited for may be late
            while time.monotonic() < ends:
                try:
                    answer = await ws.receive(timeout=0.2)
                except TimeoutError:
                    continue
                if answer.type != aiohttp.WSMsgType.BINARY:
                    break
                answers.append(msgpack.unpackb(answer.data[12:], strict_map_key=False))
                if last is not None and answers[-1].get("id") == last:
                    break
    return answers


def talk(served, *messages, headers=None, last=None):
    return asyncio.run(_talk(served, messages, headers, last))


def get(served, path, headers=None):
    async def fetch():
        async with aiohttp.ClientSession() as client:
            from yarl import URL

            url = URL(served.origin + path, encoded=True)
            async with client.get(url, headers=headers or {}, allow_redirects=False) as answer:
                return answer.status, await answer.read(), dict(answer.headers)

    return asyncio.run(fetch())


def state(served):
    call = call_of("trame.state.get")
    answers = talk(served, hello(served.token), packed(call), last=call["id"])
    return next(
        a["result"]["state"]
        for a in answers
        if isinstance(a.get("result"), dict) and "state" in a["result"]
    )


def ask(served, *request):
    return talk(
        served, hello(served.token), packed(call_of("trame.trigger", "ask", list(request), {}))
    )


def asked_step(served, request, wanted):
    """The step that is shown after a request: waits for the wanted one, as a busy machine takes a while."""
    ask(served, request)
    ends = time.monotonic() + 30
    while (step := state(served)["step"]) != wanted and time.monotonic() < ends:
        time.sleep(0.1)
    return step


def test_the_token_is_never_taken_for_an_option(served):
    # It stands on a command line that trame reads: one in 64 of another alphabet would begin with a dash.
    assert re.fullmatch("[0-9a-f]{48}", served.token)


def test_who_has_the_token_is_answered(served):
    now = state(served)
    assert (
        now["step"] == 0 and {row["key"]: row["value"] for row in now["settings"]}["flow"] == "auto"
    )
    assert now["title"] == "ball.nii.gz"
    assert asked_step(served, "step", 1) == 1
    assert asked_step(served, "restart", 0) == 0


@pytest.mark.parametrize(
    "token", ["", "wrong", "wslink-secret", None, 7, ["a"], {"a": 1}, b"\xff", "x" * 10_000]
)
def test_a_wrong_token_gets_nothing(served, token):
    step = call_of("trame.trigger", "ask", ["step"], {})
    answers = talk(served, hello(token), packed(step), packed(call_of("trame.state.get")))
    assert all("error" in answer for answer in answers), answers
    assert served.token not in str(answers)
    assert all("error" in answer for answer in talk(served, packed(step)))
    assert state(served)["step"] == 0


def deep(levels):
    return b"\x91" * levels + b"\xc0"


def broken():
    """Messages that no page sends."""
    rng = random.Random(5)
    yield from (b"", b"\x00", b"\x00" * 11, b"\x00" * 12, "text", "x" * 100_000)
    yield struct.pack("<III", 1, 0, 2**32 - 1) + b"\x81"  # four gigabytes are said to come
    yield struct.pack("<III", 1, 2**32 - 1, 2**31) + b"\x81"
    yield struct.pack("<III", 1, 0, 5) + b"\xc1" * 5
    body = deep(5000)
    yield struct.pack("<III", 1, 0, len(body)) + body
    yield from (rng.randbytes(rng.randrange(1, 200)) for _ in range(20))
    for call in (
        None,
        1,
        [],
        {},
        {"id": "a"},
        {"id": 3, "method": "x"},
        {"id": "a", "method": []},
        {"id": "a", "method": {}},
        {"id": "a", "method": "trame.trigger", "args": {}},
        {"id": "a", "method": "trame.trigger", "args": []},
        {"id": "a", "method": "trame.trigger", "args": [[], [], {}]},
        call_of("trame.trigger", "nothing", [], {}),
        call_of("application.exit"),
        call_of("trame.force.push", "a"),
        call_of("trame.error.client", "x" * 5000),
        call_of("viewport.image.push", {"size": [10**9, 10**9]}),
        call_of("trame.trigger", "ask", "text", {}),
        call_of("trame.trigger", "ask", ["size", 10**9, 10**9], {"a": 1}),
        call_of("trame.trigger", "shown", [1e308, -1], {}),
        call_of("trame.trigger", "ask", [["deep"] * 100] * 20, {}),
        call_of("trame.trigger", "ask", ["save", "../../x"], {}),
        call_of("trame.trigger", "ask", ["x" * 20_000], {}),
        call_of("trame.state.update", [{"key": "picture", "value": "javascript:alert(1)"}]),
        call_of("trame.state.update", [{"key": "trame__template_main", "value": "<h1>mine</h1>"}]),
        call_of("trame.lifecycle.update", "server_bind"),
        call_of("wslink.hello", {"secret": "x"}),
    ):
        yield packed(call)


def test_broken_messages_do_not_hurt(served):
    before = served.memory_mb()
    for message in broken():
        for known in (False, True):
            talk(served, *([hello(served.token)] if known else []), message)
    now = state(served)
    assert (
        now["step"] == 0
        and "mine" not in now["trame__template_main"]
        and now["picture"][:5] in ("data:", "")
    )
    assert served.process.poll() is None
    assert served.memory_mb() < before + 300
    assert asked_step(served, "step", 1) == 1
    assert asked_step(served, "restart", 0) == 0
    assert not served.results.exists()


def test_files_are_handed_out_by_name_and_token_alone(served):
    assert asked_step(served, "step", 1) == 1
    ask(served, "save", "labels", "run")
    for _ in range(50):
        names = [file["name"] for file in state(served)["files"]]
        if names:
            break
        time.sleep(0.2)
    assert names == ["ball_run.toml", "ball_seg.nii.gz"]
    status, body, headers = get(served, f"/files/ball_run.toml?secret={served.token}")
    assert status == 200 and body == (served.results / "ball_run.toml").read_bytes()
    assert headers["Content-Disposition"] == 'attachment; filename="ball_run.toml"'
    for wrong in ("", "?secret=", "?secret=wrong", "?token=" + served.token):
        assert get(served, "/files/ball_run.toml" + wrong)[0] == 403
    (served.results / "other.txt").write_text("not saved by the session")
    for path in (
        "other.txt",
        "..%2Flog",
        "%2e%2e/log",
        "../log",
        "..%5Clog",
        "%2Fetc%2Fpasswd",
        "ball_run.toml%00",
        "",
        "%ff",
        "a" * 5000,
    ):
        status, body, _ = get(served, f"/files/{path}?secret={served.token}")
        assert (
            status in (400, 403, 404, 405, 414)
            and b"root:" not in body
            and b"not saved" not in body
        ), path
    assert asked_step(served, "restart", 0) == 0


def test_nothing_but_the_page_is_served(served):
    up = "..%2f" * 12
    for path in (
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        f"/assets/{up}etc/passwd",
        "/.git/config",
    ):
        status, body, _ = get(served, path)
        assert status in (302, 400, 403, 404) and b"root:" not in body, path
    status, body, headers = get(served, "/index.html")
    assert status == 200 and served.token.encode() not in body
    assert (
        "default-src 'self'" in headers["Content-Security-Policy"]
        and headers["Referrer-Policy"] == "no-referrer"
    )


def test_other_sites_and_other_machines_are_refused(served):
    assert get(served, "/index.html", {"Host": "evil.example:80"})[0] == 403
    assert get(served, "/index.html", {"Host": f"localhost:{served.port}"})[0] == 200
    assert get(served, "/index.html", {"Origin": "http://evil.example"})[0] == 403
    with pytest.raises(aiohttp.WSServerHandshakeError):
        talk(served, hello(served.token), headers={"Origin": "http://evil.example"})
    # Another address of this machine is not listened on.
    with pytest.raises(OSError), socket.create_connection(("127.0.0.2", served.port), timeout=5):
        pass


def open_sockets(served):
    """Connections that the server holds, by the system's table."""
    port = f":{served.port:04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(row[1].endswith(port) and row[3] == "01" for row in rows)


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux's table of connections")
def test_idle_and_half_open_connections_are_few(served):
    """1,300 were kept. Whoever has the token comes in all the same, and stays in."""

    async def flood():
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{served.origin}/ws") as page,
        ):
            await page.send_bytes(hello(served.token))
            assert (await page.receive(timeout=20)).type == aiohttp.WSMsgType.BINARY
            idle = []
            for number in range(300):
                idle.append(await asyncio.open_connection("127.0.0.1", served.port))
                if number % 2:
                    idle[-1][1].write(b"GET /index.html HTTP/1.1\r\nHost: 127")
            await asyncio.sleep(0.5)
            held = open_sockets(served)
            await page.send_bytes(packed(call_of("trame.state.get", number=2)))
            answer = await page.receive(timeout=20)
            for _, writer in idle:
                writer.close()
            return held, answer.type

    held, answer = asyncio.run(flood())
    assert held <= MAX_CONNECTIONS
    assert answer == aiohttp.WSMsgType.BINARY
    assert get(served, "/index.html")[0] == 200


def test_a_page_that_leaves_while_something_is_sent_fails_nothing():
    """The page after it gets the message all the same; what is no page's leaving is still said."""
    from aiohttp.web import Application
    from wslink.protocol import ServerProtocol, WslinkHandler

    class Connection:
        def __init__(self, error=None):
            self.error, self.got = error, []

        async def send_bytes(self, data):
            if self.error is not None:
                raise self.error
            self.got.append(data)

    async def send(*connections):
        handler = WslinkHandler(ServerProtocol())
        handler.connections = dict(enumerate(connections))
        handler.authentified_client_ids = set(handler.connections)
        server = SimpleNamespace(app=Application(), _ws_handlers=[handler])
        PageGuard(LOCAL, "token", dict).install(server)
        await handler.sendWrappedMessage("publish:state:0", {"step": 3})

    # While it is written, and while it waits to be written.
    for error in (
        aiohttp.ClientConnectionResetError("Cannot write to closing transport"),
        ConnectionError("lost"),
    ):
        left, stays = Connection(error), Connection()
        asyncio.run(send(left, stays))
        assert msgpack.unpackb(stays.got[0][12:])["result"] == {"step": 3} and not left.got
    with pytest.raises(ZeroDivisionError):
        asyncio.run(send(Connection(ZeroDivisionError()), Connection()))


def test_a_connection_without_the_token_may_not_stay(monkeypatch):
    """Neither one that never asks nor one that asks slowly; with the token it may."""

    class Transport:
        def __init__(self, port):
            self.port, self.open = port, True

        def get_extra_info(self, name):
            return "127.0.0.1", self.port

        def abort(self):
            self.open = False

    now = 100.0
    monkeypatch.setattr(guard.time, "monotonic", lambda: now)
    server = SimpleNamespace(connection_made=lambda *_: None, connection_lost=lambda *_: None)
    limit = ConnectionLimit()
    limit.watch(server)
    silent, asking, known = (Transport(port) for port in (1, 2, 3))
    for transport in (silent, asking, known):
        server.connection_made(SimpleNamespace(transport=transport), transport)
    limit.trust(known)
    now += 0.6 * MAX_IDLE
    limit.requested(asking)
    now += 0.6 * MAX_IDLE
    limit.close_idle()
    assert (silent.open, asking.open, known.open) == (False, True, True)
    server.connection_lost(SimpleNamespace(transport=asking))
    assert [one.transport for one in limit.connections.values()] == [known]


def test_a_host_must_be_asked_for_and_warns(tmp_path):
    server = Served(tmp_path, "--host", "0.0.0.0")
    try:
        with socket.create_connection(("127.0.0.2", server.port), timeout=10):
            pass
    finally:
        assert server.close() == 0, server.log_text()
    assert "warning: --host 0.0.0.0" in server.log_text()


def test_options_of_the_page_are_refused_for_a_window(tmp_path, capsys):
    for option in (["--host", "0.0.0.0"], ["--port", "80"], ["--no-open"]):
        assert cli.execute(["view", str(tmp_path / "a.nii"), *option]) == 2
        assert "with --browser only" in capsys.readouterr().err


def test_a_port_that_is_taken_is_one_line(served, capfd):
    assert (
        cli.execute(
            ["view", str(served.image), "--browser", "--no-open", "--port", str(served.port)]
        )
        == 7
    )
    error = capfd.readouterr().err
    assert (
        len(error.splitlines()) == 2 and f"127.0.0.1:{served.port}: cannot be listened on" in error
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("ratio", ["nan", -1, 0, 1e9, None, "x", [2]])
def test_no_ratio_makes_a_picture_too_large(served, ratio):
    ask(served, "size", 3000, 2000, ratio)
    assert state(served)["ready"] in (True, False)
    ask(served, "size", 640, 360, 1)


def test_without_trame_one_line_says_what_to_install(tmp_path, monkeypatch, capsys):
    volume, center = viewing.ball_image()
    io.write(volume, tmp_path / "ball.nii.gz")
    monkeypatch.setitem(sys.modules, "trame.app", None)
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 5.0))
    assert cli.execute(["view", str(tmp_path / "ball.nii.gz"), "--browser", "--start", start]) == 2
    error = capsys.readouterr().err
    assert "trame is not installed" in error and 'pip install "accelsurf[viewer]"' in error


# -- driven by a real browser -------------------------------------------------------------------------------


@contextmanager
def driven(folder, *flags):
    """Chromium without a screen, downloading into a folder."""
    driver = viewing.needs_chromium_driver()
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    for flag in (
        *viewing.CHROMIUM_FLAGS,
        *flags,
        "--window-size=1280,863",
        f"--user-data-dir={folder / 'profile'}",
    ):
        options.add_argument(flag)
    options.add_experimental_option(
        "prefs", {"download.default_directory": str(folder / "downloads")}
    )
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service(driver))
    try:
        yield browser
    finally:
        browser.quit()


def until(what, seconds=40):
    """Wait until something is true; return it."""
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        if found := what():
            return found
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds} s")


def test_load_run_pause_back_slide_save_download(tmp_path):
    viewing.needs_chromium_driver()
    server = Served(tmp_path)
    try:
        with driven(tmp_path) as browser:
            _drive(browser, server, tmp_path)
    finally:
        assert server.close() == 0, server.log_text()
    # What was steered in the page is the same run from the command line, byte for byte.
    again = tmp_path / "again"
    config = server.results / "ball_run.toml"
    assert (
        cli.execute(
            ["segment", str(server.image), "--config", str(config), "-o", str(again), "--quiet"]
        )
        == 0
    )
    assert (again / "ball_seg.nii.gz").read_bytes() == (
        server.results / "ball_seg.nii.gz"
    ).read_bytes()


def _drive(browser, server, folder):
    def element(name):
        return browser.find_element("id", name)

    def slide(name, value):
        browser.execute_script(
            "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('change'))",
            element(name),
            value,
        )

    def step():
        return int(element("step").text.split()[1])

    def picture():
        return element("picture").get_attribute("src")

    browser.get(server.address)
    first = until(lambda: browser.find_elements("id", "picture") and picture())
    element("play").click()
    until(lambda: step() > 3)
    element("play").click()
    until(lambda: element("state").text in ("paused", "converged"))
    reached = step()
    assert until(lambda: picture() != first)
    slide("back", 2)
    until(lambda: step() == 2)
    slide("set-smoothness", 0.3)
    until(lambda: server_says(element, "set-smoothness", "0.3"))
    element("single").click()
    until(lambda: step() == 3)
    before = picture()
    from selenium.webdriver import ActionChains

    chains = ActionChains(browser)
    chains.move_to_element_with_offset(element("picture"), -200, 0).click_and_hold().move_by_offset(
        60, 10
    ).release()
    chains.perform()
    until(lambda: picture() != before)
    browser.find_element("css selector", "#panel-picture summary").click()
    browser.find_element("css selector", "#theme option[value=light]").click()
    until(lambda: "light" in browser.find_element("css selector", ".page").get_attribute("class"))
    browser.find_element("css selector", "#color option[value=speed]").click()
    time.sleep(1.0)
    shot = folder / "page.png"
    browser.save_screenshot(str(shot))
    with Image.open(shot) as opened:
        assert np.asarray(opened.convert("L")).std() > 20
    assert reached > 3
    element("save").click()
    link = until(lambda: browser.find_elements("link text", "ball_seg.nii.gz"))[0]
    link.click()
    saved = folder / "downloads" / "ball_seg.nii.gz"
    until(saved.exists)
    assert saved.read_bytes() == (server.results / "ball_seg.nii.gz").read_bytes()
    # Nothing came from elsewhere.
    loaded = browser.execute_script(
        "return performance.getEntriesByType('resource').map(entry => entry.name)"
    )
    assert loaded and all(name.startswith((server.origin, "data:")) for name in loaded), loaded
    severe = [
        entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"
    ]
    # trame asks a launcher first, which is not there.
    assert not [message for message in severe if "/paraview/" not in message], severe


@pytest.mark.slow
def test_a_stroke_and_the_list_of_changes_in_the_page(tmp_path):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.keys import Keys

    server = Served(tmp_path)
    try:
        with driven(tmp_path) as browser:
            browser.get(server.address)

            def lines():
                rows = browser.find_elements("css selector", "#history button")
                states = (
                    ("undone" in row.get_attribute("class"), row.get_attribute("aria-current"))
                    for row in rows
                )
                return [(row.text, *state) for row, state in zip(rows, states, strict=True)]

            picture = until(lambda: browser.find_elements("id", "picture"))[0]
            until(lambda: browser.find_element("id", "state").text == "paused")
            assert [row[0] for row in lines()] == ["0: as at first"]
            picture.send_keys("o")
            until(
                lambda: (
                    browser.find_element("id", "tool-outside").get_attribute("aria-checked")
                    == "true"
                )
            )
            picture.send_keys("i")
            until(
                lambda: (
                    browser.find_element("id", "tool-inside").get_attribute("aria-checked")
                    == "true"
                )
            )
            width, height = picture.size["width"], picture.size["height"]
            before = picture.get_attribute("src")
            chain = ActionChains(browser).move_to_element_with_offset(
                picture, int(-0.2 * width), int(-0.1 * height)
            )
            chain.click_and_hold()
            for _ in range(4):
                chain.move_by_offset(6, 1)
            chain.perform()
            drawn = until(
                lambda: picture.get_attribute("src") != before and picture.get_attribute("src")
            )
            assert len(lines()) == 1  # nothing is asked of the session before the release
            ActionChains(browser).release().perform()
            until(lambda: len(lines()) == 2)
            assert lines()[1][0].startswith("1: inside: stroke of") and lines()[1][1:] == (
                False,
                "true",
            )
            until(lambda: picture.get_attribute("src") != drawn)
            browser.find_element("id", "change-0").click()
            until(lambda: lines()[1][1] and lines()[0][2] == "true")
            browser.find_element("id", "change-1").click()
            until(lambda: not lines()[1][1] and lines()[1][2] == "true")
            picture.send_keys(Keys.CONTROL, "z")
            until(lambda: lines()[1][1])
            assert not browser.find_element(
                "id", "next-uncertain"
            ).is_enabled()  # the run has not ended
    finally:
        assert server.close() == 0, server.log_text()


def server_says(element, name, value):
    label = element(name).find_element("xpath", "..")
    return value in label.text
