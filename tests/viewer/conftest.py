"""Fixtures of several tests of the viewer."""

import gc

import pytest

from accelsurf.viewer.scene.scene import Scene


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory):
    """What programs of these tests note about their use stays out of the user's own folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="module", autouse=True)
def no_former_windows():
    """Windows of closed scenes, which hold themselves, are freed here and not while another one is drawn."""
    gc.collect()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A page of the viewer, served to the tests of a module; one that needs more of it has a fixture of its own."""
    from tests.viewer.test_browser import Served

    server = Served(tmp_path_factory.mktemp("served"))
    yield server
    assert server.close() == 0, server.log_text()


@pytest.fixture
def scene_of():
    """Makes scenes, closed at the end of the test."""
    made = []

    def make(*args, **options):
        made.append(Scene(*args, **options))
        return made[-1]

    yield make
    for scene in made:
        scene.close()
