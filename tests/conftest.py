"""What every test may use."""

import os
from pathlib import Path

import pytest

from accelsurf.levelset import threads


@pytest.fixture(scope="session")
def real_volumes() -> Path:
    """Folder of real scans; the test is skipped where ACCELSURF_VOLUMES does not name one."""
    folder = os.environ.get("ACCELSURF_VOLUMES", "")
    if not folder:
        pytest.skip("ACCELSURF_VOLUMES is not set")
    if not Path(folder).is_dir():
        pytest.fail(f"ACCELSURF_VOLUMES names {folder}, which is not a folder")
    return Path(folder)


@pytest.fixture(autouse=True)
def calls_shared_out(monkeypatch) -> None:
    """What is longer than a grain is shared out, whatever it takes: else tests would seldom use two threads."""
    monkeypatch.setattr(threads, "SHARED_FROM", 0.0)
    monkeypatch.setattr(threads, "SHORTEST", 1e-9)
