"""A server as a person starts it, in an empty folder that is also its home."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

KEY = "a key of the tests, long enough"


@dataclass(frozen=True)
class Running:
    """A server: its address, its process and the folder that it may write to."""

    address: str
    process: subprocess.Popen[str]
    folder: Path

    def files(self) -> set[str]:
        return {str(path.relative_to(self.folder)) for path in self.folder.rglob("*")}


def started(folder: Path, *options: str) -> Running:
    """Start a server on a free port; the kernels' storage stays where it is."""
    home = {"HOME": str(folder), "TMPDIR": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}
    process = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", "serve", "--port", "0", *options],
        cwd=folder,
        env=os.environ | home,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline().strip()
    if not line.startswith("http://127.0.0.1:"):
        process.kill()
        pytest.fail(line + process.communicate()[0])
    return Running(line, process, folder)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    running = started(tmp_path_factory.mktemp("served"), "--api-key", KEY, "--max-sessions", "3")
    yield running
    running.process.kill()
    running.process.communicate()
