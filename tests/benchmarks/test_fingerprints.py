"""Fingerprints of runs: what they cover, and that they see what changes."""

import json
import re
from pathlib import Path

import pytest

import accelsurf
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.flow_specs import FLOWS
from benchmarks import fingerprints

SAVED = Path(fingerprints.__file__).parent / "results" / "fingerprints.json"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return fingerprints.runs(tmp_path_factory.mktemp("fingerprints"))


def test_every_flow_and_every_term_has_a_run(runs):
    names = " ".join(runs)
    assert len(runs) >= 40
    assert all(f"flow {flow}" in names and f"flow {flow}, two objects" in runs for flow in FLOWS)
    assert all(re.search(rf"\b{term}\b", names) for term in TERMS)
    for word in (
        "levels",
        "edits",
        "one slice",
        "thick slices",
        "two threads",
        "mask",
        "region",
        "noise",
    ):
        assert word in names


def test_the_saved_ones_are_of_these_runs(runs):
    saved = json.loads(SAVED.read_text())
    assert set(saved["runs"]) == set(runs)
    assert {"processor", "numba", "numpy"} <= set(saved["where"])


@pytest.mark.threads
def test_a_fingerprint_sees_a_change_and_nothing_else(runs):
    cube = fingerprints.cube(24)
    settings = {"start": "ball:12,12,12,5vox", "max_steps": 5, "levels": 1}
    first, again, other = (
        fingerprints.fingerprint(
            accelsurf.segment(cube, threads=threads, smoothness=smoothness, **settings)
        )
        for threads, smoothness in ((1, 0.2), (2, 0.2), (1, 0.2001))
    )
    assert first == again
    assert first["trace"] != other["trace"] and first["psi"] != other["psi"]
