"""Edits and kept states: a run that was steered, or that went back, is the same run, byte for byte."""

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import result_of, segment
from accelsurf.energies import ChanVese
from accelsurf.errors import UsageError
from accelsurf.image.volume import Volume
from accelsurf.levelset import LevelSet, checkpoint_surface, restore_surface
from accelsurf.run.run import Run
from accelsurf.settings.corrections import CORRECTION_KEYS
from accelsurf.settings.edits import Edit, edits_of
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.run_config import RunConfig
from tests.support.level_set_checks import check_level_set


def volume(shape=(24, 30, 34), spacing=(1.5, 1.0, 1.0), seed=0):
    z, y, x = np.indices(shape)
    ball = ((z - 11) * spacing[0]) ** 2 + (y - 15) ** 2 + (x - 17) ** 2 < 10**2
    return Volume.from_array(
        (ball * 100 + np.random.default_rng(seed).normal(0, 30, shape)).astype(np.float32), spacing
    )


def state(run):
    """All that a run has, as bytes."""
    found = []
    for one in run.objects:
        surface = one.surface
        records = [
            record._replace(seconds=0.0, cells_visited=0) for record in one.evolution.history
        ]
        fields = b"".join(np.ascontiguousarray(f).tobytes() for f in one.flow.fields)
        arrays = (surface.dense.psi, surface.dense.slot, *surface.band)
        data = b"".join(a.tobytes() for a in arrays) + fields
        found.append(
            (data, records, one.evolution.state.time, surface.inside_beyond_band, one.corner)
        )
    return found


def stepped(run, steps):
    for _ in range(steps):
        assert run.step()
    return run


# ------------------------------------------------------------------------------------------------------- kept surface


@pytest.mark.sampled
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (3.0, 1.0, 1.0)])
@pytest.mark.parametrize("what", ["ball", "border", "hollow", "filled", "none", "slice"])
def test_a_surface_comes_back_bit_for_bit(what, spacing):
    z, y, x = np.indices((1 if what == "slice" else 18, 20, 22)).astype(np.float32)
    far = np.sqrt((0 if what == "slice" else (z - 9) ** 2) + (y - 10) ** 2 + (x - 11) ** 2)
    psi = {
        "ball": far - 6,
        "slice": far - 6,
        "border": x + y - 12,
        "hollow": np.abs(far - 6) - 3,
        "filled": 0 * far - 1,
        "none": 0 * far + 1,
    }[what]
    surface = LevelSet(psi, spacing)
    kept = checkpoint_surface(surface)
    before = [a.copy() for a in (surface.dense.psi, surface.dense.slot, *surface.band)]
    beyond = surface.inside_beyond_band
    other = LevelSet(np.roll(5.0 - far, 3, axis=2), spacing, 4.0)
    for target in (surface, other):
        surface.dense.psi[:] = 7.0
        restore_surface(target, kept)
        for a, b in zip((target.dense.psi, target.dense.slot, *target.band), before, strict=True):
            assert a.dtype == b.dtype and np.array_equal(a, b)
        assert (
            target.inside_beyond_band == beyond
            and target.half_width == kept.requested_half_width * target.slant
        )
        assert not check_level_set(target) or what in ("filled", "none", "hollow")
    assert kept.nbytes < 40 * surface.size + surface.psi.size / 4 + 64


# ------------------------------------------------------------------------------------------------------- kept runs


@pytest.mark.sampled(2)
@pytest.mark.parametrize("energy", ["chan-vese", pytest.param("geodesic", marks=pytest.mark.slow)])
@pytest.mark.parametrize("flow", FLOWS)
def test_going_back_and_on_is_the_same_run(flow, energy):
    noise = {}
    if flow in ("constant-density", "flowable-mass"):
        noise, flow = {"noise": 0.05, "seed": 3}, f"{flow}:noise_time=50"
    config = RunConfig(
        start="ball:17,15,16,6",
        flow=flow,
        energy=energy,
        smoothness=0.1,
        balloon=-0.5,
        levels=1,
        threads=1,
        max_steps=60,
        **noise,
    )
    straight, back = Run(volume(), config), Run(volume(), config)
    stepped(straight, 33)
    kept = {}
    for _ in range(33):
        kept[back.step_number] = back.checkpoint()
        back.step()
    assert state(back) == state(straight)
    for k in (21, 5, 0, 30):
        back.restore(kept[k])
        assert back.step_number == k
        stepped(back, 33 - k)
        assert state(back) == state(straight), k
    _ended(straight)
    _ended(back)
    assert result_of(straight).labels.tobytes() == result_of(back).labels.tobytes()
    assert straight.stop == back.stop
    assert state(back) == state(straight)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "energy",
    [
        "likelihood",
        "likelihood:histogram",
        "local-region:R=4",
        "threshold:auto",
        "chan-vese + 0.2*local-region:R=4",
    ],
)
def test_going_back_with_any_energy_in_a_region_with_a_mask(energy, tmp_path):
    image = volume()
    mask = np.ones(image.array.shape, np.uint8)
    mask[:, :, :13] = 0
    io.write_labels(image.with_array(mask), tmp_path / "mask.nii.gz")
    config = RunConfig(
        start="ball:17,15,16,6",
        energy=energy,
        levels=1,
        threads=1,
        max_steps=24,
        mask=str(tmp_path / "mask.nii.gz"),
        roi="2,3,4,28,29,30vox",
        edit=["step=9 smoothness=0.4 half_width=5", "step=15 energy=geodesic"],
    )
    straight, back = _ended(Run(image, config)), Run(image, config)
    kept = {}
    for _ in range(20):
        kept[back.step_number] = back.checkpoint()
        back.step()
    for k in (17, 12, 3):
        back.restore(kept[k])
        stepped(back, 20 - k)
    assert state(_ended(back)) == state(straight)
    labels = result_of(straight).labels
    assert labels.any() and not labels[mask == 0].any() and not labels[:4].any()
    assert result_of(back).labels.tobytes() == labels.tobytes()


def _ended(run):
    for _ in run:
        pass
    return run


@pytest.mark.slow
def test_going_back_from_the_end():
    run = Run(volume(), RunConfig(start="ball:17,15,16,6", levels=1))
    kept = {}
    while run.stop is None:
        kept[run.step_number] = run.checkpoint()
        run.step()
    end, stop, last = state(run), run.stop, run.step_number - 1
    assert stop.reason == "converged"
    # Also from right before the stop, which looks back at a surface a window before.
    for k in (last, last - 7, 2):
        run.restore(kept[k])
        assert run.stop is None
        assert state(_ended(run)) == end and run.stop == stop


def test_keeping_changes_nothing_and_a_state_outlives_the_run():
    config = RunConfig(start="ball:17,15,16,6", levels=1, flow="flowable-mass")
    plain, kept = stepped(Run(volume(), config), 12), Run(volume(), config)
    states = []
    for _ in range(12):
        states.append(kept.checkpoint())
        kept.step()
    assert state(kept) == state(plain)
    other = Run(volume(), config)
    other.restore(states[7])
    stepped(other, 5)
    assert state(other) == state(plain)


def test_an_energy_of_ones_own_goes_back_too():
    runs = []
    for _ in range(2):
        run = Run(
            volume(),
            RunConfig(start="ball:17,15,16,6", levels=1),
            lambda image, h: ChanVese(image, 0.1),
        )
        kept = None
        for _ in range(9):
            kept = kept or run.checkpoint()
            run.step()
        runs.append((run, kept))
    (run, kept), (straight, _) = runs
    run.restore(kept)
    assert state(stepped(run, 9)) == state(straight)


# ------------------------------------------------------------------------------------------------------- edits

EDITS = [
    "step=0 smoothness=0.1",
    "step=6 smoothness=0.4 diffusion=0.5",
    "step=9 half_width=5",
    "step=14 cfl=0.3 friction=0.8",
    "step=20",
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("flow", FLOWS)
def test_edits_from_the_start_and_while_it_runs_are_the_same(flow):
    config = RunConfig(start="ball:17,15,16,6", flow=flow, levels=1, max_steps=30)
    given = Run(volume(), config.replace(edit=EDITS))
    live = Run(volume(), config)
    stepped(given, 26)
    edits = edits_of(EDITS)
    while live.step_number < 26:
        live.set_edits(tuple(edit for edit in edits if edit.step <= live.step_number))
        live.step()
    assert state(live) == state(given)
    assert [row.edits for row in given.history] == [
        sum(edit.step == step for edit in edits) for step in range(26)
    ]
    assert not check_level_set(given.objects[0].surface)
    assert given.settings.smoothness == 0.4 and given.settings.cfl == 0.3
    plain = stepped(Run(volume(), config), 26)
    assert state(plain) != state(given)


@pytest.mark.slow
@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("other", ["constant-density", "flowable-mass", "gradient"])
def test_another_flow_and_energy_on_the_way_and_back_again(flow, other):
    edits = [
        f"step=8 flow={other}",
        "step=15 energy=geodesic balloon=-0.2",
        f"step=19 flow={flow} energy=chan-vese",
    ]
    config = RunConfig(start="ball:17,15,16,6", flow=flow, levels=1, edit=edits)
    straight, back = Run(volume(), config), Run(volume(), config)
    stepped(straight, 26)
    kept = {}
    for _ in range(26):
        kept[back.step_number] = back.checkpoint()
        back.step()
    assert state(back) == state(straight)
    for k in (19, 8, 12, 16, 3):
        back.restore(kept[k])
        stepped(back, 26 - k)
        assert state(back) == state(straight), k
    assert (straight.settings.flow, straight.settings.energy) == (flow, "chan-vese")


def test_the_account_goes_on_over_edits():
    edits = [
        "step=15 smoothness=0.3",
        "step=20 half_width=5",
        "step=28 flow=constant-density:k=1.5,lam=2",
        "step=36 flow=gradient",
    ]
    result = segment(
        volume(),
        start="ball:17,15,16,6",
        levels=1,
        edit=edits,
        max_steps=40,
        diffusion=0,
        percentile=100,
        flow="constant-density",
    )
    rows = [row for row in result.history if row.level == 0][:36]
    budgets = [
        r.potential
        + r.mass_potential
        + r.kinetic / r.weight
        + r.friction_work
        + r.smoothing_work
        - r.noise_work
        for r in rows
    ]
    won = abs(rows[0].potential)
    plain = segment(
        volume(),
        start="ball:17,15,16,6",
        levels=1,
        max_steps=40,
        diffusion=0,
        percentile=100,
        flow="constant-density",
    )
    drift = max(
        abs(
            r.potential
            + r.kinetic / r.weight
            + r.friction_work
            + r.smoothing_work
            - plain.history[0].potential
        )
        for r in plain.history[:36]
    )
    assert max(abs(b - budgets[0]) for b in budgets) < max(3 * drift, 0.01 * won), (
        drift / won,
        budgets,
    )


def test_an_edit_begins_the_stop_rule_anew():
    options = {"start": "ball:17,15,16,6", "levels": 1}
    plain = segment(volume(), **options)
    assert plain.stop.reason == "converged"
    on = segment(volume(), **options, edit=[Edit(step=plain.stop.steps)])
    # One window more, or two where the trend needs them.
    assert on.stop.reason == "converged" and on.stop.steps - plain.stop.steps in (20, 40)
    missed = segment(volume(), **options, edit=[Edit(step=plain.stop.steps + 1, smoothness=1)])
    assert missed.labels.tobytes() == plain.labels.tobytes()
    assert [w for w in missed.warnings if "was not made" in w] and missed.edits_done == 0
    assert missed.report["edits"] == [
        {"step": plain.stop.steps + 1, "smoothness": 1, "done": False}
    ]


def test_edits_on_levels_count_steps_over_all_of_them():
    edits = ["step=5 energy=geodesic balloon=-0.5", "step=12 smoothness=0.2"]
    result = segment(
        volume((40, 40, 40), (1, 1, 1)), start="ball:17,15,16,8", levels=2, edit=edits, max_steps=60
    )
    assert [row.step for row in result.history if row.edits] == [5, 12] and result.history[
        5
    ].level == 1
    assert result.edits_done == 2


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        ("smoothness=1", "no step was given"),
        ("step=-2 smoothness=1", "step -2 was given, expected a whole number at least 0"),
        ("step=1.5", "step 1.5 was given"),
        ({"step": True}, "step true was given"),
        ("step=3 smothness=1", "edit at step 3: smothness: there is no such setting"),
        ("step=3 start=center", "edit at step 3: start cannot change while a run runs"),
        (
            "step=3 smoothness=-1",
            "edit at step 3: smoothness: -1 was given, expected a number at least 0",
        ),
        ("step=3 cfl=fast", "edit at step 3: cfl: fast was given"),
        ("step=3 cfl", "words like step=30"),
        ("step=3 cfl=1 cfl=1", "cfl was given twice"),
        ("", "words like step=30"),
        (7, "7 was given, expected a step and the settings that change"),
    ],
)
def test_nonsense_is_one_clear_line(edit, message):
    with pytest.raises(UsageError) as caught:
        RunConfig(edit=edit)
    assert message in str(caught.value) and "\n" not in str(caught.value) and caught.value.hint


@pytest.mark.parametrize("key", ["add", *CORRECTION_KEYS])
@pytest.mark.parametrize("form", ["text", "table", "toml"])
def test_a_correction_of_a_surface_that_moves_is_refused_with_the_way_to_make_it(
    key, form, tmp_path
):
    path = tmp_path / "run.toml"
    path.write_text(f'[[edit]]\nstep = 4\n{key} = "ball:1,2,3,4"\n')
    with pytest.raises(UsageError) as caught:
        if form == "toml":
            RunConfig.from_toml(path)
        else:
            RunConfig(edit=f"step=4 {key}=3" if form == "text" else [{"step": 4, key: 3}])
    assert caught.value.message == (
        f"edit at step 4: {key} was given, and a surface that moves takes no correction"
    )
    assert "--max-steps 4 --end present --refine inside=" in caught.value.hint


def test_settings_of_an_own_energy_do_not_change():
    with pytest.raises(
        UsageError, match="edit at step 4: smoothness was given, but the energy is one of your own"
    ):
        segment(
            volume(),
            energy=lambda image, h: ChanVese(image),
            start="ball:17,15,16,6",
            edit="step=4 smoothness=1",
        )


def test_toml_and_back(tmp_path):
    config = RunConfig(edit=EDITS)
    path = tmp_path / "run.toml"
    path.write_text(config.to_toml())
    assert RunConfig.from_toml(path) == config
    assert '[[edit]]\nstep = 9\nhalf_width = "5"\n' in config.to_toml()
    assert (
        config.at(5).smoothness == 0.1 and config.at(6).diffusion == 0.5 and config.at(6).edit == ()
    )


def test_no_steps_leave_the_start():
    result = segment(volume(), start="ball:17,15,16,6", max_steps=0, levels=1)
    assert result.stop.reason == "max-steps" and result.stop.steps == 0
    assert result.volume_mm3 == pytest.approx(4 / 3 * np.pi * 6**3, rel=0.02)
