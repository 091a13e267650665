"""The page of promises names trials that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "explanation" / "trust.md").read_text(encoding="utf-8")


def test_every_trial_exists():
    rows = [
        line
        for line in PAGE.splitlines()
        if line.startswith("| ") and not line.startswith("| promise")
    ]
    assert len(rows) > 20
    for row in rows:
        _, promise, trials, longer, _ = (part.strip() for part in row.split("|"))
        folder = None
        assert trials, promise
        for name in re.findall(r"`([^`]+)`", trials):
            path = ROOT / name if "/" in name else folder / name
            assert path.exists() and path.name.startswith("test_"), (promise, name)
            folder = path.parent
        for command in re.findall(r"`(scripts/[^`]+)`", longer):
            script, *words = command.split()
            text = (ROOT / script).read_text(encoding="utf-8")
            if script in ("scripts/study", "scripts/paper_figures"):
                pages = [path.stem for path in (ROOT / "benchmarks").rglob("*.py")]
                assert words[0] in text or words[0].replace("-", "_") in pages, command


@pytest.mark.parametrize("script", ["fuzz", "kills", "study"])
def test_the_longer_trials_can_be_run(script):
    path = ROOT / "scripts" / script
    assert path.stat().st_mode & 0o111 and path.read_text(encoding="utf-8").startswith("#!")
