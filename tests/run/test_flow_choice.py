"""The flow where the settings leave it open: by the energy, and what was given; the report says which."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from accelsurf import refine, segment
from accelsurf.flows import ConstantDensity, Gradient
from accelsurf.image.volume import Volume
from accelsurf.output.document import report_of
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

START = {"start": "ball:12,12,12,5vox", "threads": 1}


def ball(noise: float, n: int = 24) -> NDArray[np.float32]:
    """A ball of contrast 1 in the middle."""
    z, y, x = np.indices((n, n, n)) - 0.5 * n
    image = 1.0 * (z**2 + y**2 + x**2 < (0.3 * n) ** 2)
    return (100.0 * (image + np.random.default_rng(5).normal(0.0, noise, image.shape))).astype(
        np.float32
    )


def selected(image: NDArray[np.float32], **settings: object) -> tuple[str, str]:
    """Flow and reason of a run that is not made."""
    config = RunConfig(**{**START, **settings})
    with Run(Volume.from_array(image), config) as run:
        assert run.config.flow == run.settings.flow == config.flow
        moved = {ConstantDensity: "constant-density", Gradient: "gradient"}[
            type(run.objects[0].evolution.flow)
        ]
        assert moved == run.flow_choice.applied(config).flow
        return moved, run.flow_choice.why


@pytest.mark.parametrize("noise", [0.0, 0.8])
def test_energy_and_settings_decide(noise: float) -> None:
    image = ball(noise)
    assert selected(image)[0] == selected(image, smoothness=0.1)[0] == "constant-density"
    assert (
        selected(image, energy="threshold:50,")[0]
        == selected(image, energy="threshold:50, + 0.1*area")[0]
        == "gradient"
    )
    assert selected(image, energy="threshold:50, + local-region:R=4")[0] == "constant-density"
    assert (
        selected(image, inside="ball:12,12,12,3vox", start="clicks", energy="seeded")[0]
        == "constant-density"
    )
    found, why = selected(image, energy="threshold:50,", friction=3.0)
    assert found == "constant-density" and "friction was given" in why
    assert selected(image, energy="threshold:50,", diffusion=0.5)[0] == "gradient"


def test_the_report_says_which_flow_and_why_and_the_settings_stay_open() -> None:
    result = segment(ball(0.0), **START, energy="threshold:50,")
    report = report_of(result)
    assert report["config"]["flow"] == "auto" and report["resolved_settings"]["flow"] == "gradient"
    assert report["resolved_settings"]["flow_why"].startswith(
        "descent, as under bounds of brightness "
    )
    given = segment(ball(0.0), **START, flow="sobolev").resolved_settings
    assert (given["flow"], given["flow_why"]) == ("sobolev", "sobolev, as it was given")


@pytest.mark.parametrize("energy", ["chan-vese", "threshold:50,"])
def test_it_is_the_same_run_as_with_that_flow(energy: str) -> None:
    image, given = ball(0.4), {**START, "energy": energy}
    found = segment(image, **given)
    assert (
        found.psi.tobytes()
        == segment(image, **given, flow=found.resolved_settings["flow"]).psi.tobytes()
    )


def test_an_edit_does_not_choose_again_but_for_a_setting_of_momentum() -> None:
    given = {**START, "energy": "threshold:50,"}
    rows = segment(ball(0.0), **given, edit=["step=3 smoothness=0.1"]).history
    assert len(rows) > 5 and all(row.kinetic == 0.0 for row in rows)
    rows = segment(ball(0.0), **given, edit=["step=3 friction=2"]).history
    assert rows[2].kinetic == 0.0 and any(row.kinetic > 0.0 for row in rows[3:])


def test_corrections_go_on_with_the_flow_of_the_run() -> None:
    result = segment(ball(0.0), **START, energy="threshold:50,")
    mended = refine(result, outside="point:18,12,12vox")
    assert mended.config.flow == "auto" and mended.resolved_settings["flow"] == "gradient"
    assert len(mended.history) > len(result.history)
    assert all(row.kinetic == 0.0 for row in mended.history)
