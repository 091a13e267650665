"""Converged objects that a neighbour moves into move again; two that overlap do not set each other going for ever."""

from types import SimpleNamespace

import numpy as np
import pytest

from accelsurf.evolution.records import Stop
from accelsurf.image.volume import Volume
from accelsurf.run.ensemble import REACTIVATION_DEPTH, Ensemble
from accelsurf.run.run import Run
from accelsurf.settings.edits import Edit
from accelsurf.settings.run_config import RunConfig


class Converged:
    """An object that has converged, and how deep, in mm, its neighbour is inside it."""

    moves, as_neighbour, surface = False, None, None

    def __init__(self, depth):
        self.reactivations, self.depth = 0, depth
        self.contact = SimpleNamespace(set_neighbours=list, overlap=lambda _: self.depth)
        self.evolution = SimpleNamespace(stop=Stop("converged", 5, 1.0, ""), max_steps=100)

    def reactivate(self):
        self.reactivations += 1


@pytest.mark.parametrize("spacing", [1.0, 0.25])
def test_each_further_time_the_neighbour_must_be_deeper(spacing):
    step = REACTIVATION_DEPTH * spacing
    one, moving = Converged(0.9 * step), SimpleNamespace(moves=True, as_neighbour=None)
    moving.evolution = SimpleNamespace(stop=None)
    ensemble = Ensemble([one, moving], SimpleNamespace(threads=1), (spacing,) * 3, True)
    for depth, times in ((0.9, 0), (1.1, 1), (1.9, 1), (2.1, 2), (2.9, 2), (1.1, 2), (3.1, 3)):
        one.depth = depth * step
        ensemble.reactivate_touched([[1], [0]])
        assert one.reactivations == times


def test_the_count_is_in_checkpoints_and_begins_anew_with_an_edit():
    z, y, x = np.indices((16, 16, 20)).astype(float)
    ball = np.sqrt((z - 8) ** 2 + (y - 8) ** 2 + (x - 9) ** 2) < 5.5
    config = RunConfig(start="ball:9,8,8,3", max_steps=8, threads=1)
    with Run(Volume.from_array(ball.astype(np.float32), 1.0), config) as run:
        run.step()
        run.objects[0].reactivations = 3
        kept = run.checkpoint()
        run.objects[0].reactivations = 5
        run.restore(kept)
        assert run.objects[0].reactivations == 3
        run.set_edits((Edit(step=run.step_number, cfl=0.3),))
        run.apply_edits()
        assert run.objects[0].reactivations == 0
