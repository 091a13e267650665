"""``accelsurf fetch``, from a server on this machine: what is shown, what is refused, and that nothing is left then."""

import hashlib
import http.server
import re
import threading
import tomllib

import pytest

from accelsurf.cli import execute, fetch

pytestmark = pytest.mark.program

IMAGE, LABELS = b"image" * 1000, b"labels" * 100
#: Licences that let anybody use and share a scan.
OPEN = {"Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC-BY-4.0", "CC0-1.0", "MIT"}


@pytest.fixture
def server(monkeypatch, tmp_path):
    """What is served, by path, and a list of what was asked for; the table has a sample of two files of it."""
    asked, served = [], {"/scan.bin": IMAGE, "/labels.bin": LABELS}

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            content = served.get(self.path)
            self.send_response(404 if content is None else 200)
            length = len(content or b"") + (1000 if self.path in served.get("cut short", ()) else 0)
            self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(content or b"")

        def log_message(self, *_):
            pass

    listening = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=listening.serve_forever)
    thread.start()
    files = "".join(
        f'[a.files."a{end}"]\npath="{path}"\nbytes={len(content)}\nsha256="{hashlib.sha256(content).hexdigest()}"\n'
        for end, path, content in (
            (".nii.gz", "scan.bin", IMAGE),
            ("_labels.nii.gz", "labels.bin", LABELS),
        )
    )
    table = tmp_path / "samples.toml"
    base = f"http://127.0.0.1:{listening.server_address[1]}"
    table.write_text(
        f'[a]\nabout="a scan"\nlicence="MIT"\nsource="https://example.org"\ninside="ball:1,2,3,4"\nbase="{base}"\n{files}'
    )
    monkeypatch.setattr(fetch, "TABLE", table)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield served, asked
    listening.shutdown()
    thread.join()
    listening.server_close()


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "scans of mine"


def fetched(folder, *more):
    return execute(["fetch", "a", "--to", str(folder), *more])


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_scan_and_its_labels_come_once(server, folder, capsys):
    assert fetched(folder) == 0
    assert (folder / "a.nii.gz").read_bytes() == IMAGE and (
        folder / "a_labels.nii.gz"
    ).read_bytes() == LABELS
    assert names(folder) == ["a.nii.gz", "a_labels.nii.gz"]
    said = capsys.readouterr()
    assert not said.err
    assert "--inside ball:1,2,3,4" in said.out and f"'{folder / 'a.nii.gz'}'" in said.out
    assert fetched(folder) == 0 and "there already" in capsys.readouterr().out
    assert server[1] == ["/scan.bin", "/labels.bin"]


def test_licence_source_and_checksums_are_shown_before_anything_is_asked_for(
    server, folder, capsys, monkeypatch
):
    monkeypatch.setattr(fetch, "fetch_all", lambda *_: shown.append(capsys.readouterr().out))
    shown = []
    assert fetched(folder) == 0
    assert "licence MIT, source https://example.org" in shown[0]
    assert hashlib.sha256(IMAGE).hexdigest() in shown[0] and "/labels.bin" in shown[0]
    assert not server[1] and not folder.exists()


@pytest.mark.parametrize(
    ("path", "sent", "word"),
    [
        ("/scan.bin", b"other" * 1000, "checksum"),
        ("/labels.bin", LABELS[::-1], "checksum"),
        ("/labels.bin", LABELS * 10_000, "checksum"),
        ("/labels.bin", b"", "checksum"),
        ("/labels.bin", None, "status 404"),
    ],
)
def test_what_is_not_the_file_is_refused_and_nothing_is_left(
    server, folder, capsys, path, sent, word
):
    server[0][path] = sent
    assert fetched(folder) == 3
    said = capsys.readouterr().err
    assert word in said and path in said and said.count("error:") == 1 and "Traceback" not in said
    assert not names(folder)


def test_a_connection_that_breaks_off_leaves_nothing(server, folder, capsys):
    server[0]["cut short"] = ("/scan.bin",)
    assert fetched(folder) == 3 and "cannot be fetched" in capsys.readouterr().err
    assert not names(folder)


def test_no_server_is_one_line(server, folder, capsys, monkeypatch):
    table = fetch.TABLE.read_text().replace("http://127.0.0.1:", "http://127.0.0.1:1/")
    fetch.TABLE.write_text(table)
    assert fetched(folder) == 3 and "ConnectionError" in capsys.readouterr().err
    assert not names(folder)


def test_a_file_of_the_user_s_stays(server, folder, capsys):
    folder.mkdir()
    (folder / "a_labels.nii.gz").write_bytes(b"mine")
    assert fetched(folder) == 7 and "exists already" in capsys.readouterr().err
    assert (folder / "a_labels.nii.gz").read_bytes() == b"mine" and names(folder) == [
        "a_labels.nii.gz"
    ]
    server[0]["/scan.bin"] = b"other"
    assert (
        fetched(folder, "--overwrite") == 3 and (folder / "a_labels.nii.gz").read_bytes() == b"mine"
    )
    server[0]["/scan.bin"] = IMAGE
    assert (
        fetched(folder, "--overwrite") == 0 and (folder / "a_labels.nii.gz").read_bytes() == LABELS
    )


@pytest.mark.parametrize("words", [[], ["b"]])
def test_a_name_is_wanted_and_known(server, words, capsys):
    assert execute(["fetch", *words]) == 2
    said = capsys.readouterr().err
    assert "--list" in said or "expected a" in said


def test_the_list_has_open_licences_and_addresses_that_cannot_change(capsys):
    assert execute(["fetch", "--list"]) == 0
    shown = capsys.readouterr().out
    for name, sample in tomllib.loads(fetch.TABLE.read_text(encoding="utf-8")).items():
        assert name in shown and sample["licence"] in OPEN and sample["licence"] in shown
        assert re.search(r"^https://.*/[0-9a-f]{40}/", sample["base"])
        for key, file in sample["files"].items():
            assert (
                key.startswith(name)
                and len(bytes.fromhex(file["sha256"])) == 32
                and 0 < file["bytes"] < 1e7
            )
