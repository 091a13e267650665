"""The protocol of energies: the defaults do nothing, and energies made of others hand every call on."""

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.energies import CheckedEnergy, Energy, WeightedSum
from accelsurf.energies.constraints.contact import NonOverlap
from accelsurf.energies.constraints.mask import MaskConstraint
from accelsurf.levelset import BandChange, LevelSet

SHAPE = (14, 15, 16)


def ball(radius=4.0):
    z, y, x = (np.indices(SHAPE).T - (np.array(SHAPE) - 1) / 2).T
    return LevelSet(np.sqrt(z**2 + y**2 + x**2) - radius, (1, 1, 1))


class Constant(Energy):
    """U = Vol, f = 1, with nothing of its own."""

    def value(self, surface, fraction, area):
        return surface.volume(fraction)

    def force(self, surface, front, curvature):
        return front.astype(np.float32)


class Recording(Constant):
    """Notes what is called; its state is a number."""

    alpha = 0.25

    def __init__(self):
        self.calls = []

    def start(self, surface):
        self.calls.append("start")

    def follow(self, surface, change):
        self.calls.append("follow")

    def project(self, surface):
        self.calls.append("project")

    def state(self):
        return 42

    def restore(self, surface, state):
        self.calls.append(("restore", state))


def test_the_defaults_do_nothing_and_restore_starts_again():
    class Started(Constant):
        starts = 0

        def start(self, surface):
            self.starts += 1

    surface, energy = ball(), Started()
    before = surface.psi.copy()
    energy.follow(surface, BandChange(np.empty(0, np.int64), np.empty(0, np.int64), []))
    energy.project(surface)
    assert energy.alpha == 0 and energy.state() is None and energy.starts == 0
    energy.restore(surface, None)
    assert energy.starts == 1
    np.testing.assert_array_equal(surface.psi, before)


def test_value_and_force_must_be_given():
    with pytest.raises(TypeError, match="abstract method"):
        Energy()


@pytest.mark.parametrize(
    "made_of",
    [
        lambda inner: MaskConstraint(inner, np.full(SHAPE, -5, np.float32)),
        lambda inner: NonOverlap(inner, (0, 0, 0)),
        CheckedEnergy,
        lambda inner: NonOverlap(
            MaskConstraint(CheckedEnergy(inner), np.full(SHAPE, -5, np.float32)), (0, 0, 0)
        ),
    ],
)
def test_every_call_reaches_the_inner_energy(made_of):
    surface, inner = ball(), Recording()
    energy = made_of(inner)
    energy.start(surface)
    energy.project(surface)
    energy.follow(surface, BandChange(np.empty(0, np.int64), np.empty(0, np.int64), []))
    energy.restore(surface, energy.state())
    assert inner.calls == ["start", "project", "follow", ("restore", 42)]
    assert energy.alpha == 0.25


def test_a_sum_hands_each_term_its_own_state():
    surface, one, other = ball(), Recording(), Constant()
    energy = WeightedSum([(2.0, one), (0.5, other)])
    assert energy.state() == [42, None] and energy.alpha == 0.5
    energy.project(surface)
    energy.restore(surface, energy.state())
    assert one.calls == ["project", ("restore", 42)]


def test_an_energy_without_a_base_may_keep_the_surface_out_of_a_half_space():
    """It grows everywhere; ``project``, of which no base class knows here, keeps it at x >= 6."""

    class HalfSpace:
        alpha = 0.0

        def start(self, surface):
            pass

        def follow(self, surface, change):
            pass

        def value(self, surface, fraction, area):
            return -surface.volume(fraction)

        def force(self, surface, front, curvature):
            return -front.astype(np.float32)

        def project(self, surface):
            cells = surface.band.cells
            x = np.unravel_index(cells, surface.shape)[2]
            surface.dense.psi[cells] = np.maximum(
                surface.dense.psi[cells], np.float32(5.5) - x.astype(np.float32)
            )

    result = segment(
        np.arange(16**3.0).reshape(16, 16, 16),
        energy=HalfSpace(),
        start="ball:10,8,8,3vox",
        max_steps=25,
    )
    inside = np.argwhere(result.labels)
    assert inside[:, 2].min() == 6 and inside[:, 1].min() < 3
