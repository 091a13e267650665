"""Clicked voxels stay on their sides: force, momentum, small components, and the energy budget."""

import numpy as np
import pytest

from accelsurf.energies import Balloon, ChanVese, WeightedSum
from accelsurf.energies.constraints.clicks import ClickConstraint
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, Gradient
from accelsurf.flows.descent import HeavyBall
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.levelset import LevelSet

SHAPE = (24, 24, 24)


def constraint(energy, shape=SHAPE, spacing=(1.0, 1.0, 1.0), **sides):
    clicks = tuple(
        Click(side, bounding_box(mask), mask[bounding_box(mask)]) for side, mask in sides.items()
    )
    grid = pyramid.levels(shape, spacing, 1)[0]
    return ClickConstraint(energy, click_bounds(Clicks(clicks, shape), grid))


def distance(shape=SHAPE, centre=(11.5, 11.5, 11.5)):
    return np.linalg.norm(np.moveaxis(np.indices(shape), 0, -1) - np.array(centre), axis=-1)


def ball(radius, bounds=None):
    psi = (distance() - radius).astype(np.float32)
    if bounds is not None:
        bounds.apply(psi)
    return LevelSet(psi, (1.0, 1.0, 1.0))


def voxel(*place):
    mask = np.zeros(SHAPE, bool)
    mask[place] = True
    return mask


def pushing(sign):
    """An energy that makes the whole surface shrink (1) or grow (-1)."""
    return WeightedSum([(float(sign), Balloon())])


def sides(surface, **masks):
    inside = surface.labels.astype(bool)
    return (
        inside[masks["inside"]].all() if "inside" in masks else not inside[masks["outside"]].any()
    )


@pytest.mark.parametrize(
    "flow", [ConstantDensity, FlowableMass, Gradient, HeavyBall], ids=lambda flow: flow.name
)
@pytest.mark.parametrize(
    ("sign", "side", "place"), [(1, "inside", (11, 11, 17)), (-1, "outside", (11, 11, 20))]
)
def test_the_surface_does_not_cross_a_click(flow, sign, side, place):
    mask = voxel(*place)
    energy = constraint(pushing(sign), **{side: mask})
    evolution = Evolution(ball(7.0), energy, SolverSetup(flow()), 24)
    crossed = [step.record.step for step in evolution if not sides(step.surface, **{side: mask})]
    assert not crossed and len(evolution.history) == 25
    free = Evolution(ball(7.0), pushing(sign), SolverSetup(flow()), 24)
    assert [step.record.step for step in free if not sides(step.surface, **{side: mask})], (
        "the test shows nothing"
    )
    if sign > 0:
        # Its own component lives on after the rest has vanished: that is no convergence to nothing.
        assert evolution.surface.size and evolution.stop.reason != "vanished"


@pytest.mark.parametrize(
    "flow", [ConstantDensity, FlowableMass, HeavyBall], ids=lambda flow: flow.name
)
def test_no_force_and_no_momentum_acts_into_a_click_and_the_budget_has_the_loss(flow, monkeypatch):
    energy, flow = constraint(pushing(-1), outside=voxel(11, 11, 20)), flow()
    evolution = Evolution(ball(7.0), energy, SolverSetup(flow), 24)
    evolution.initialize()
    jumps, losses, acted = [], [], 0
    record, add, move = evolution.state.budget.record_jump, flow.add_velocity, flow.move

    def added(surface, change):
        area = surface.fraction_and_area()[1]
        before = flow.energy(area)
        add(surface, change)
        losses.append(before - flow.energy(area))

    def moved(now, limits):
        nonlocal acted
        slots, _, keeps_out = energy.touched_slots(now.surface)
        held = slots[keeps_out & now.front[slots]]
        acted += held.size
        assert (now.force[held] >= 0).all() and (
            flow.normal_velocity(now.surface)[held] >= -1e-5
        ).all()
        return move(now, limits)

    monkeypatch.setattr(
        evolution.state.budget, "record_jump", lambda lost: (jumps.append(lost), record(lost))
    )
    monkeypatch.setattr(flow, "add_velocity", added)
    monkeypatch.setattr(flow, "move", moved)
    for _ in evolution:
        pass
    assert acted > 20 and losses and jumps == losses
    if flow.name != "momentum":  # whose steps have no energy
        assert min(losses) > 0


def test_a_click_away_from_the_surface_has_a_component_that_lives_on():
    mask = voxel(3, 4, 5)
    image = (distance() < 7).astype(np.float32)
    energy = constraint(ChanVese(image, alpha=1.0), inside=mask)
    surface = ball(5.0, energy.bounds)
    evolution = Evolution(surface, energy, SolverSetup(ConstantDensity()), 30)
    removed = sum(step.record.removed_components for step in evolution)
    assert removed == 0 and surface.labels[3, 4, 5] == 1
    assert surface.labels.sum() > 1000 and surface.labels[:7, :8, :9].sum() < 60


def test_only_held_components_stay():
    psi = (distance() - 7).astype(np.float32)
    psi[3, 3, 3] = psi[3, 3, 20] = -0.5
    surface = LevelSet(psi, (1.0, 1.0, 1.0))
    assert surface.remove_small(np.array([np.ravel_multi_index((3, 3, 20), SHAPE)])) == 1
    assert surface.labels[3, 3, 3] == 0 and surface.labels[3, 3, 20] == 1


def test_the_constraint_changes_nothing_where_it_does_not_act():
    image = (distance() < 7).astype(np.float32)
    runs = []
    for energy in (
        ChanVese(image, alpha=0.3),
        constraint(ChanVese(image, alpha=0.3), inside=distance() < 1.2),
    ):
        evolution = Evolution(ball(5.0), energy, SolverSetup(ConstantDensity()), 20)
        for _ in evolution:
            pass
        runs.append(evolution.surface.psi.copy())
    np.testing.assert_array_equal(*runs)
