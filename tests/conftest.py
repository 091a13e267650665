"""What every test may use."""

import base64
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from accelsurf.levelset import threads
from accelsurf.output.pictures import preview
from tests.support.quick_commands import signatures_read_once
from tests.support.sampling import sampled

#: A picture of one pixel.
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4//8/AAX+Av4N70a4AAAAAElFTkSuQmCC"
)


@pytest.hookimpl(tryfirst=True)  # before tests are selected by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow the cases that a test with the mark ``sampled`` does not need by default."""
    cases = defaultdict(list)
    for item in items:
        if item.get_closest_marker("sampled") is not None:
            cases[item.nodeid.partition("[")[0]].append(item)
    for group in cases.values():
        count = next(iter(group[0].get_closest_marker("sampled").args), None)
        needed = sampled(
            [{name: id(value) for name, value in item.callspec.params.items()} for item in group],
            count,
        )
        for number, item in enumerate(group):
            if number not in needed:
                item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def real_volumes() -> Path:
    """Folder of real scans; the test is skipped where ACCELSURF_VOLUMES does not name one."""
    folder = os.environ.get("ACCELSURF_VOLUMES", "")
    if not folder:
        pytest.skip("ACCELSURF_VOLUMES is not set")
    if not Path(folder).is_dir():
        pytest.fail(f"ACCELSURF_VOLUMES names {folder}, which is not a folder")
    return Path(folder)


@pytest.fixture(scope="session", autouse=True)
def commands_are_quick() -> Iterator[None]:
    """Run commands in this process without what a program does once, and without waiting for the disk.

    A power cut is no part of a test: what was written is read back all the same. A run has 25 such waits.
    """
    with signatures_read_once(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture(autouse=True)
def calls_shared_out(request, monkeypatch) -> None:
    """Share out every call longer than a grain in tests with the mark ``threads``.

    Small images would seldom use two threads else. To share out all calls of all tests takes a third of their time.
    """
    if request.node.get_closest_marker("threads") is not None:
        monkeypatch.setattr(threads, "SHARED_FROM", 0.0)
        monkeypatch.setattr(threads, "SHORTEST", 1e-9)


@pytest.fixture(autouse=True)
def previews_are_not_drawn(request, monkeypatch) -> None:
    """A run's preview is a pixel, as drawing takes longer than a small run; it is drawn for tests with a mark."""
    if request.node.get_closest_marker("pictures") is None:
        monkeypatch.setattr(preview, "preview_png", lambda content: PIXEL)
