"""Fixtures of several tests of the viewer."""

import pytest

from accelsurf.viewer.scene.scene import Scene


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
