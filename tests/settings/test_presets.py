"""Presets: settings under those given, each explained, and each doing its work on a phantom of its modality."""

import json

import numpy as np
import pytest

from accelsurf import cli
from accelsurf.api.segment import segment, segment_objects
from accelsurf.errors import UsageError
from accelsurf.measure.metrics import dice
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig
from tests.support import tissues
from tests.support.tissue_scan import SPACING, grid, noisy


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_says_what_each_value_means_and_where_it_was_tried(name):
    preset = PRESETS[name]
    assert set(preset.reasons) == set(preset.settings) and all(
        len(why) > 5 for why in preset.reasons.values()
    )
    assert preset.tried and all(len(outcome) > 5 for outcome in preset.tried.values())
    config = RunConfig(preset=name, start="ball:0,0,0,5")
    for key, value in preset.settings.items():
        assert key == "start" or getattr(config, key) == value
    # A value that is the default says so much, but no setting may be one that means nothing.
    assert config.unused() == []


def test_values_beside_a_preset_win_wherever_they_come_from(tmp_path, capsys):
    assert RunConfig(preset="ct-skeleton", presmooth=0.5).presmooth == 0.5
    assert (
        RunConfig(preset="mr-white-matter", levels="auto").levels == "auto"
    )  # also where it is the default
    file = tmp_path / "run.toml"
    file.write_text('preset = "mr-brain"\nbalance = 1.7\n')
    config = RunConfig.from_toml(file)
    assert (config.balance, config.epsilon) == (1.7, PRESETS["mr-brain"].settings["epsilon"])
    # On the command line a preset stands for options: over the file, under the options.
    assert (
        run(
            "segment",
            "--config",
            file,
            "--preset",
            "ct-skeleton",
            "--presmooth",
            "0.3",
            "--dump-config",
        )
        == 0
    )
    dumped = capsys.readouterr().out
    (tmp_path / "dumped.toml").write_text(dumped)
    again = RunConfig.from_toml(tmp_path / "dumped.toml")
    assert again.preset == "ct-skeleton" and again.presmooth == 0.3
    assert again.smoothness == PRESETS["ct-skeleton"].settings["smoothness"]


def test_a_preset_replaces_the_values_of_another_but_not_those_that_were_set():
    config = RunConfig(preset="ct-skeleton", tolerance=0.3).replace(preset="mr-brain")
    assert config == RunConfig(preset="mr-brain", tolerance=0.3)
    assert config.replace(preset=None) == RunConfig(tolerance=0.3)
    assert RunConfig(preset="ct-skeleton").replace(presmooth=1.0).preset == "ct-skeleton"


def test_a_preset_that_changes_nothing_says_so_before_the_run():
    given = {"start": "ball:9,9,9,4", "energy": "chan-vese"}
    assert RunConfig(preset="fluorescence-nucleus", **given).unused() == []  # presmooth is left
    image, said = np.zeros((20, 20, 20)), []
    image[5:15, 5:15, 5:15] = 9
    options = {
        "preset": "fluorescence-nucleus",
        **given,
        "presmooth": 0.0,
        "max_steps": 2,
        "on_warning": said.append,
    }
    warnings = segment(image, **options).warnings
    assert warnings == said and said[-1].startswith("preset was given, but has no effect on ")


def test_a_preset_that_is_none_is_one_clear_line():
    with pytest.raises(
        UsageError, match="preset: ct-bones was given, expected ct-skeleton, mr-brain"
    ):
        RunConfig(preset="ct-bones")
    with pytest.raises(UsageError, match="preset"):
        RunConfig(preset=3)


def test_info_lists_them(capsys):
    assert run("info", "presets") == 0
    shown = capsys.readouterr().out
    for name, preset in PRESETS.items():
        assert name in shown and all(why in shown for why in preset.reasons.values())
    assert run("info", "--json") == 0
    assert set(json.loads(capsys.readouterr().out)["presets"]) == set(PRESETS)


# ------------------------------------------------------------------------------------------------ on phantoms


def found(preset, image, *starts, **clicks):
    result = segment(
        image, spacing=SPACING, preset=preset, **({"start": starts} if starts else {}), **clicks
    )
    assert result.stop.reason == "converged" and result.config.preset == preset
    return result.labels


@pytest.mark.slow
def test_bone_between_soft_tissue_with_contrast_agent():
    z, y, x = grid()
    body = x**2 + y**2 + (0.6 * z) ** 2 < 17**2
    bone = ((x + 6) ** 2 + y**2 < 4**2) & body
    vessel = ((x - 6) ** 2 + y**2 < 4**2) & body
    image = noisy(-1000.0 + 1050 * body + 650 * bone + 100 * vessel, 15)
    assert dice(found("ct-skeleton", image), bone) > 0.9


def test_brain_on_zeros_with_dim_remains_of_the_stripping():
    z, y, x = grid()
    r = np.sqrt(x**2 + y**2 + z**2)
    image = np.where(r < 15, noisy(90.0 * (r < 15), 6), 0) + 30.0 * ((r >= 15) & (r < 17))
    assert dice(found("mr-brain", image, "center"), r < 15) > 0.95


def test_nuclei_of_uneven_brightness():
    z, y, x = grid()
    nuclei = [(x - a) ** 2 + y**2 + z**2 < 6**2 for a in (-10, 8)]
    image = noisy(10.0 + 60 * nuclei[0] + 25 * nuclei[1], 6)
    assert dice(found("fluorescence-nucleus", image), nuclei[0] | nuclei[1]) > 0.85


def test_cells_between_membranes_part_the_space_between_them(tmp_path):
    image, truth, centres = tissues.membrane_cells((14, 36, 36), 5, seed=3)
    rows = [f"{n},{x},{y},{z},1.5,inside" for n, (z, y, x) in enumerate(centres.tolist(), 1)]
    table = "\n".join(["id,x_vox,y_vox,z_vox,r_vox,side", *rows])
    (tmp_path / "cells.csv").write_text(table)
    found = segment_objects(image, str(tmp_path / "cells.csv"), preset="membrane-cells").labels
    scores = [dice(found == n, truth == n) for n in range(1, 6)]
    assert min(scores) > 0.9 and np.mean(scores) > 0.95
    assert (found == 0).mean() < 0.02
