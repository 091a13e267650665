"""Trips: image, settings and a click pass few files on their way to the loop."""

import pytest

from tests.support.trips import TRIPS

#: Largest number of files. A click in a run from a click goes through the model of the evidence from clicks, too.
LIMITS = {
    "volume, from a ball": 40,
    "volume, from a click": 40,
    "config, from a ball": 50,
    "config, from a click": 50,
    "click after the end": 27,  # one bounds its reach
    "click after the end of a run from a ball": 22,  # one reads units and RAS in texts of places
}


@pytest.fixture(autouse=True)
def state_folder(tmp_path, monkeypatch):
    """What a viewer notes about its use stays out of the user's folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


@pytest.mark.parametrize("name", LIMITS)
def test_few_files_on_the_way(name):
    trip = TRIPS[name]()
    assert 5 <= len(trip.files) <= LIMITS[name], "\n".join(trip.lines())
