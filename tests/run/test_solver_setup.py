"""Every flow with every energy, in 3D and on a curve: the settings reach what they are for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.flows import ConstantDensity, FlowableMass, Gradient, HeavyBall, Sobolev
from accelsurf.measure.metrics import dice
from accelsurf.run.setup import half_width, make_flow, stop_rule
from accelsurf.settings.energy_terms import image_terms
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig

BALL = (24, 24, 24)
#: Those of clicks are held under every flow in test_clicks.py.
FROM_A_START = [name for name in image_terms() if name not in ("seeded", "partition")]


def image(shape: tuple[int, int, int] = BALL) -> tuple[np.ndarray, np.ndarray]:
    centre = [(n - 1) / 2 for n in shape]
    z, y, x = (axis - c for axis, c in zip(np.indices(shape), centre, strict=True))
    truth = z**2 + y**2 + x**2 < 7**2
    return truth, (truth + np.random.default_rng(1).normal(0, 0.05, shape)).astype(np.float32)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("shape", [BALL, (1, 24, 24)], ids=["surface", "curve"])
@pytest.mark.parametrize(
    "energy",
    [*FROM_A_START, "likelihood:histogram", "0.5*chan-vese + threshold:0.5, - 0.05*balloon"],
)
@pytest.mark.parametrize("flow", FLOWS)
def test_every_flow_takes_every_energy(flow: str, energy: str, shape: tuple[int, int, int]) -> None:
    """From a ball around the object, or beside its middle, to a Dice above 0.9 with a falling energy."""
    truth, scan = image(shape)
    z = "0" if shape[0] == 1 else "12"
    start = f"ball:11.5,11.5,{z},9.5vox" if energy == "geodesic" else f"ball:10,12,{z},4vox"
    text = {"threshold": "threshold:auto", "local-region": "local-region:R=5"}.get(energy, energy)
    result = segment(scan, flow=flow, energy=text, start=start, max_steps=300)
    found = dice(result.labels, truth)
    print(f"\n{flow}, {energy}, {shape}: Dice {found:.3f}, {result.stop}")
    assert result.history[-1].potential < result.history[0].potential
    # The geodesic energy alone lies about 2 sigma^2/r inside a small ball's edge; a narrow Gaussian takes none of the
    # voxels that are in between.
    assert found > {"geodesic": 0.88, "likelihood": 0.9}.get(energy, 0.95)
    assert result.warnings == []


def test_settings_reach_the_flow() -> None:
    settings = {
        "friction": 0.7,
        "diffusion": 0.25,
        "noise": 0.1,
        "seed": 9,
    }
    flow = make_flow(
        RunConfig(flow="constant-density:k=3,lam=2,rho=0.5,noise_length=5", **settings)
    )
    assert isinstance(flow, ConstantDensity) and flow.noise is not None
    assert (flow.clock.k, flow.clock.lambda_, flow.rho, flow.clock.friction, flow.diffusion) == (
        3,
        2,
        0.5,
        0.7,
        0.25,
    )
    assert (flow.noise.strength, flow.noise.length, flow.noise.seed, flow.noise.until) == (
        0.1,
        5,
        9,
        None,
    )
    heavy = make_flow(RunConfig(flow="flowable-mass:gravity=0.3,t0=0.5,k=0.5", smoothness=0.2))
    assert isinstance(heavy, FlowableMass)
    assert (heavy.gravity, heavy.support, heavy.clock.t0, heavy.diffusion) == (0.3, 0.2, 0.5, None)
    for diffusion, want in (("auto", 0.0), ("free", None), (2.0, 2.0)):
        descent = make_flow(RunConfig(flow="gradient", diffusion=diffusion))
        assert isinstance(descent, Gradient) and descent.diffusion == want
    sobolev, momentum = (
        make_flow(RunConfig(flow="sobolev:length=4")),
        make_flow(RunConfig(flow="momentum:blend=0.5")),
    )
    assert isinstance(sobolev, Sobolev) and sobolev.length == 4
    assert isinstance(momentum, HeavyBall) and momentum.blend == 0.5


def test_the_band_is_as_wide_as_the_flow_needs() -> None:
    assert half_width(RunConfig()) == 3 and half_width(RunConfig(flow="flowable-mass")) == 4
    assert half_width(RunConfig(flow="flowable-mass", half_width=5)) == 5


def test_a_setting_that_does_nothing_is_told() -> None:
    _, scan = image()
    result = segment(scan, flow="gradient", friction=1.0, start="ball:10,12,12,4vox", max_steps=3)
    assert result.warnings == [
        "friction was given, but has no effect on flow gradient with energy chan-vese"
    ]


@pytest.mark.slow
def test_for_k_of_at_most_1_the_clock_starts_when_the_first_step_is_made() -> None:
    truth, scan = image()
    for flow in ("constant-density", "flowable-mass"):
        result = segment(scan, flow=f"{flow}:k=0.8", start="ball:10,12,12,4vox", max_steps=300)
        assert dice(result.labels, truth) > 0.9


def test_a_mass_that_flows_is_waited_for_on_one_grid_too() -> None:
    for levels in (1, 2):
        assert (
            stop_rule(RunConfig(flow="flowable-mass"), levels).motion == 0.4 * RunConfig().tolerance
        )
        assert stop_rule(RunConfig(), levels).motion == RunConfig().tolerance


@pytest.mark.slow
def test_a_mass_that_flows_ends_near_its_end_in_noise() -> None:
    """At the motion of other flows its surface had a fifth of a voxel to go."""
    truth, _ = image()
    scan = (truth + np.random.default_rng(3).normal(0, 1.0, truth.shape)).astype(np.float32)
    words: dict[str, Any] = {"flow": "flowable-mass", "start": "ball:10,12,12,4vox", "levels": 1}
    result = segment(scan, max_steps=400, **words)
    after = segment(scan, max_steps=result.stop.steps + 100, tolerance=1e-6, **words)
    apart = np.abs(after.psi - result.psi)[np.abs(result.psi) < 0.5]
    assert result.stop.reason == "converged" and apart.mean() < 0.1
