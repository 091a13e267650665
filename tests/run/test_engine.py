"""One engine for one and many objects: levels, edits, checkpoints, energies of one's own; what holds for one holds for
many.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.api.segment import result_of, segment, segment_objects
from accelsurf.cli import execute
from accelsurf.energies import ChanVese
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.evolution.records import StepRecord
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import states
from accelsurf.measure.metrics import dice
from accelsurf.run import checkpoint
from accelsurf.run.checkpoint import checkpoint_header, load_checkpoint, save_checkpoint
from accelsurf.run.evolving_object import roomy_box
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig

SHAPE, SPACING = (20, 28, 44), (1.4, 1.0, 1.0)
CENTRES, RADIUS = ((13.0, 14.0, 14.0), (13.0, 14.0, 29.0)), 8.5
IDS = (4, 300)


def distances(centres, radius):
    places = [i * h for i, h in zip(np.indices(SHAPE).astype(float), SPACING, strict=True)]
    return [
        np.sqrt(sum((p - c) ** 2 for p, c in zip(places, centre, strict=True))) - radius
        for centre in centres
    ]


@pytest.fixture(scope="module")
def pair():
    """Two balls that nearly touch, in noise; a label map of their starts; the truth."""
    away = np.array(distances(CENTRES, RADIUS))
    image = np.clip(0.5 - away.min(axis=0), 0, 1) + np.random.default_rng(5).normal(0, 0.2, SHAPE)
    starts, truth = np.zeros(SHAPE, np.int32), np.zeros(SHAPE, np.int32)
    for own, one, small in zip(IDS, away, distances(CENTRES, 4.0), strict=True):
        starts[small < 0] = own
        truth[one < 0] = own
    return Volume.from_array(image.astype(np.float32), SPACING), starts, truth


def content(run):
    """All that a run has, as bytes."""
    found = []
    for one in run.objects:
        surface = one.surface
        arrays = [surface.dense.psi, surface.dense.slot, *surface.band, *one.flow.fields]
        records = [
            record._replace(seconds=0.0, cells_visited=0) for record in one.evolution.history
        ]
        found.append(
            (
                one.id,
                one.corner,
                b"".join(np.ascontiguousarray(a).tobytes() for a in arrays),
                records,
            )
        )
    return found


def ended(run):
    for _ in run:
        pass
    return run


def stepped(run, steps):
    for _ in range(steps):
        assert run.step()
    return run


# ------------------------------------------------------------------------------------------------------ levels


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["constant-density", "flowable-mass"])
@pytest.mark.threads
def test_several_objects_run_on_levels(pair, flow):
    volume, starts, truth = pair
    result = segment_objects(volume, starts, levels=2, flow=flow, max_steps=200)
    assert [summary.level.number for summary in result.levels] == [1, 0]
    for one in result.objects:
        levels = [record.level for record in one.history]
        assert levels == sorted(levels, reverse=True) and set(levels) == {0, 1}
        assert dice(result.labels == one.id, truth == one.id) > 0.95
    assert (
        sum((one.psi < 0).sum() for one in result.objects) == (result.labels > 0).sum()
    )  # none overlap
    again = segment_objects(volume, starts, levels=2, flow=flow, max_steps=200, threads=3)
    assert again.labels.tobytes() == result.labels.tobytes()


def test_a_start_that_a_coarse_grid_does_not_resolve_begins_on_the_next(pair):
    volume, starts, _ = pair
    small = np.where(np.array(distances((CENTRES[0],), 1.2))[0] < 0, IDS[0], 0) + np.where(
        starts == IDS[1], IDS[1], 0
    )
    result = segment_objects(volume, small, levels=2, max_steps=5)
    assert [one.history[0].level for one in result.objects] == [0, 0]
    assert any("the start is not resolved there" in warning for warning in result.warnings)


def test_a_box_has_room_for_the_windows_of_the_energy_on_each_level(pair):
    volume, starts, _ = pair
    for config in (
        RunConfig(levels=2, energy="local-region:R=6", max_steps=40),
        RunConfig(levels=2, max_steps=40, edit=["step=1 energy=local-region:R=6"]),
    ):
        with Run(volume, config, objects=starts) as run:
            while run.level > 0:
                run.step()
            # 2 sqrt(6/5) R = 13.1 mm, in voxels of 1 mm on the finest level, and three more.
            one = run.objects[0]
            box = roomy_box(
                np.array([9, 13, 13]), np.array([11, 15, 15]), one._setup.reach, one.grid
            )
            assert box[2].stop == 15 + 17


# ------------------------------------------------------------------------------------------------------- edits


def test_a_setting_changes_for_all_objects(pair):
    volume, starts, _ = pair
    plain = segment_objects(volume, starts, max_steps=12)
    edits = ["step=4 smoothness=0.6", "step=6 half_width=5"]
    edited = segment_objects(volume, starts, max_steps=12, edit=edits)
    assert edited.edits_done == 2
    for one in edited.objects:
        assert [record.step for record in one.history if record.edits] == [4, 6]
        volumes = [record.volume_mm3 for record in one.history]
        before = [record.volume_mm3 for record in plain.by_id[one.id].history]
        # Before the first edit nothing differs.
        assert volumes[:4] == before[:4] and volumes[5] != before[5]
        assert one.history[6].band_cells > 1.2 * plain.by_id[one.id].history[6].band_cells


@pytest.mark.slow
def test_an_object_that_has_converged_goes_on_after_an_edit(pair):
    volume, starts, _ = pair
    plain = segment_objects(volume, starts, max_steps=200)
    steps = max(one.stop.steps for one in plain.objects)
    edited = segment_objects(
        volume, starts, max_steps=200, edit=[f"step={steps - 1} smoothness=0.1"]
    )
    assert {one.stop.reason for one in edited.objects} == {"converged"}
    for one in edited.objects:
        assert one.stop.steps >= plain.by_id[one.id].stop.steps
        assert [record.step for record in one.history] == list(range(len(one.history)))
        assert sum(record.edits for record in one.history) == 1
        assert one.history[-1].area_mm2 < plain.by_id[one.id].history[-1].area_mm2


def test_the_leak_guard_changes_with_an_edit(pair):
    volume, starts, _ = pair
    options = {"max_steps": 40, "max_volume": 700.0}
    assert segment_objects(volume, starts, **options).stop.reason == "leaked"
    raised = segment_objects(volume, starts, **options, edit=["step=2 max_volume=90000"])
    assert {one.stop.reason for one in raised.objects} <= {"converged", "max-steps"}
    alone = segment(volume, start="ball:14,14,13,5", edit=["step=3 max_volume=600"], max_steps=40)
    assert alone.stop.reason == "leaked" and "600 mm3" in alone.stop.message


def test_an_edit_holds_for_an_object_whose_coarse_level_failed(pair):
    volume = pair[0]
    small, large = (
        distances((centre,), radius)[0] < 0
        for centre, radius in zip(CENTRES, (2.9, 7.5), strict=True)
    )
    starts = np.where(small, 4, 0) + np.where(large, 300, 0)
    config = RunConfig(levels=2, smoothness=1.0, max_steps=30, edit=["step=6 smoothness=0 cfl=0.3"])
    with Run(volume, config, objects=starts) as run:
        while run.level > 0:
            run.step()
        ended_on = {
            one.id: [r for r in one.evolution.history if r.level == 1] for one in run.objects
        }
        assert len(ended_on[4]) < 6  # it vanished on the coarse level, before the edit
        assert all(one.evolution.setup.limits.cfl == 0.3 for one in run.objects)


# ------------------------------------------------------------------------------------------------- checkpoints


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "flow", ["constant-density", "flowable-mass", "gradient", "sobolev", "momentum"]
)
def test_several_objects_go_back_and_on_bit_for_bit(pair, flow):
    volume, starts, _ = pair
    config = RunConfig(flow=flow, max_steps=24, edit=["step=9 smoothness=0.05"])
    with (
        Run(volume, config, objects=starts) as straight,
        Run(volume, config, objects=starts) as back,
    ):
        stepped(straight, 20)
        checkpoints = {}
        for _ in range(20):
            checkpoints[back.step_number] = back.checkpoint()
            back.step()
        # A grid grew in between.
        assert checkpoints[3].objects[0].shape != checkpoints[17].objects[0].shape
        for k in (17, 3, 12):
            back.restore(checkpoints[k])
            assert back.step_number == k
            stepped(back, 20 - k)
            assert content(back) == content(straight), k
        assert (
            result_of(ended(back)).labels.tobytes() == result_of(ended(straight)).labels.tobytes()
        )


SAVED = {
    "auto": {},
    "momentum": {"flow": "constant-density"},
    "flowable mass on levels": {"flow": "flowable-mass", "levels": 2},
    "noise": {"noise": 0.1, "seed": 4},
    "sobolev": {"flow": "sobolev"},
    "heavy ball, likelihood": {"flow": "momentum", "energy": "likelihood:model=histogram"},
    "local region and area": {"energy": "local-region:R=5 + 0.2*area"},
    "edits": {"edit": ["step=5 smoothness=0.4"]},
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("name", SAVED)
def test_a_run_goes_on_from_a_file_with_the_same_bytes(pair, tmp_path, name, several):
    volume, starts, _ = pair
    config = RunConfig(
        max_steps=26, threads=1, **({} if several else {"start": "ball:14,14,13,5"}), **SAVED[name]
    )
    objects = starts if several else None
    with Run(volume, config, objects=objects) as straight:
        stepped(straight, 11)
        save_checkpoint(
            tmp_path / "run.checkpoint", straight.checkpoint(), checkpoint_header(straight)
        )
        whole = result_of(ended(straight))
    with Run(volume, config, objects=objects) as other:
        other.restore(load_checkpoint(tmp_path / "run.checkpoint", other))
        assert other.step_number == 11
        resumed = result_of(ended(other))
        assert content(other) == content(straight)
    assert (
        resumed.labels.tobytes() == whole.labels.tobytes()
        and resumed.psi.tobytes() == whole.psi.tobytes()
    )
    assert [s[1:] for s in resumed.levels] == [
        s[1:] for s in whole.levels
    ] and resumed.warnings == whole.warnings


@pytest.mark.threads
def test_a_checkpoint_of_another_run_is_refused(pair, tmp_path):
    volume, starts, _ = pair
    config, path = RunConfig(max_steps=5), tmp_path / "run.checkpoint"
    with Run(volume, config, objects=starts) as run:
        run.step()
        save_checkpoint(path, run.checkpoint(), checkpoint_header(run))
    for same in ({"threads": 2}, {"max_steps": 50}):
        with Run(volume, config.replace(**same), objects=starts) as run:
            assert load_checkpoint(path, run).step == 1
    swapped = np.where(starts == 4, 300, np.where(starts == 300, 4, 0))
    others = [
        Run(volume, config.replace(smoothness=0.1), objects=starts),
        Run(volume.with_array(volume.array + 1), config, objects=starts),
        Run(volume, config, objects=swapped),
        Run(volume, config, objects=starts, arrays={"mask": np.full(SHAPE, -1.0, np.float32)}),
        Run(volume, config, energy=lambda image, _: ChanVese(image), objects=starts),
        Run(volume, config, channels=[volume], objects=starts),
    ]
    for run in others:
        with (
            run,
            pytest.raises(
                InputError, match="a checkpoint of (another image or start|other settings: )"
            ),
        ):
            load_checkpoint(path, run)


def test_a_checkpoint_of_another_version_is_refused(pair, tmp_path, monkeypatch):
    """Values of records are read by their place: a field more would shift those that follow."""
    volume, starts, _ = pair
    path = tmp_path / "run.checkpoint"
    with Run(volume, RunConfig(max_steps=5), objects=starts) as run:
        run.step()
        with monkeypatch.context() as old:
            old.setattr(states, "FORMAT", 1)
            save_checkpoint(path, run.checkpoint(), checkpoint_header(run))
        with pytest.raises(InputError, match="format 1, expected"):
            load_checkpoint(path, run)
        save_checkpoint(path, run.checkpoint(), checkpoint_header(run))
        assert load_checkpoint(path, run).step == 1
        fields = [name for name in StepRecord._fields if name != "returned"]
        older = NamedTuple("StepRecord", [(name, object) for name in fields])
        monkeypatch.setitem(checkpoint.TYPES, "StepRecord", older)
        with pytest.raises(InputError, match="another version of accelsurf"):
            load_checkpoint(path, run)


def test_a_damaged_checkpoint_is_refused(pair, tmp_path):
    volume, starts, _ = pair
    path, random = tmp_path / "run.checkpoint", np.random.default_rng(1)
    with Run(volume, RunConfig(max_steps=5), objects=starts) as run:
        run.step()
        save_checkpoint(path, run.checkpoint(), checkpoint_header(run))
        whole = path.read_bytes()
        damaged = [b"", whole[:100], whole[: len(whole) // 2], b"\0" * 1000, whole[:-40]]
        for _ in range(300):
            changed = bytearray(whole)
            for place in random.integers(0, len(whole), 3):
                changed[place] = random.integers(256)
            damaged.append(bytes(changed))
        refused = 0
        for content_ in damaged:
            path.write_bytes(content_)
            try:
                load_checkpoint(path, run)
            except InputError:
                refused += 1
        # A byte of padding may change without harm; arrays have checksums.
        assert refused > 0.9 * len(damaged)
        with pytest.raises(InputError, match="cannot be read"):
            load_checkpoint(tmp_path / "absent", run)


def test_a_checkpoint_of_a_level_that_is_over_is_refused(pair):
    volume, starts, _ = pair
    with Run(volume, RunConfig(levels=2, max_steps=200), objects=starts) as run:
        coarse = run.checkpoint()
        while run.level > 0:
            run.step()
        with pytest.raises(ValueError, match="level 1"):
            run.restore(coarse)


# ------------------------------------------------------------------------------------- energies of one's own


def test_an_energy_of_ones_own_moves_several_objects_as_a_named_one_does(pair):
    volume, starts, _ = pair
    own = functools.partial(ChanVese, alpha=0.0, epsilon=1.5)
    given = {"flow": "constant-density", "max_steps": 15}
    made = segment_objects(volume, starts, energy=lambda image, spacing: own(image), **given)
    named = segment_objects(volume, starts, energy="chan-vese:area=0", **given)
    assert made.energy == "custom: ChanVese" and named.energy == "chan-vese:area=0"
    assert (
        made.labels.tobytes() == named.labels.tobytes()
        and made.psi.tobytes() == named.psi.tobytes()
    )
    with pytest.raises(UsageError, match="several were given: the energy has one image"):
        segment_objects(volume, starts, energy=ChanVese(volume.array, 0.0))


def test_the_name_of_ones_own_energy_outlives_an_edit(pair):
    volume, _, _ = pair
    edits = ["step=3 cfl=0.3"]
    made = segment(
        volume,
        start="ball:14,14,13,5",
        energy=lambda image, _: ChanVese(image),
        max_steps=6,
        edit=edits,
    )
    assert (
        made.energy == "custom: ChanVese" and made.report["config"]["energy"] == "custom: ChanVese"
    )


# ------------------------------------------------------------------------------------------- one result for all


def test_one_result_with_a_tuple_of_objects(pair):
    volume, starts, _ = pair
    one = segment(volume, start="ball:14,14,13,5", max_steps=10)
    many = segment_objects(volume, starts, max_steps=10)
    assert type(one) is type(many) is accelsurf.Result is accelsurf.ObjectsResult
    assert [o.id for o in one.objects] == [1] and not one.has_ids
    assert (
        [o.id for o in many.objects] == list(IDS)
        and many.has_ids
        and many.by_id[300] is many.objects[1]
    )
    assert one.objects[0].psi is one.psi and one.history is one.objects[0].history
    assert many.volume_mm3 == pytest.approx(sum(o.volume_mm3 for o in many.objects))
    assert len(repr(one)) < 120 and len(repr(many)) < 120 and len(repr(many.objects[0])) < 120
    assert set(one.report) == set(many.report) and one.report["objects"] is None
    assert [entry["id"] for entry in many.report["objects"]] == list(IDS)


def test_a_label_map_with_one_id_keeps_its_id(pair):
    volume, starts, _ = pair
    result = segment_objects(volume, np.where(starts == 300, 300, 0), max_steps=5)
    assert result.has_ids and set(np.unique(result.labels)) == {0, 300}


def test_segment_takes_objects_too(pair, tmp_path):
    volume, starts, _ = pair
    io.write_labels(volume.with_array(starts.astype(np.uint16)), tmp_path / "starts.nii.gz")
    by_file = segment(volume, objects=str(tmp_path / "starts.nii.gz"), max_steps=8)
    assert by_file.labels.tobytes() == segment_objects(volume, starts, max_steps=8).labels.tobytes()


# ------------------------------------------------------------------------------------ starts that are no texts

BALL = {"max_steps": 6, "levels": 1}
CORNERS = np.array([[5.0, 5, 5], [20, 5, 5], [5, 20, 5], [5, 5, 20]])
OPEN_MESH = SimpleNamespace(vertices=CORNERS, faces=np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3]]))
WRONG_FACES = SimpleNamespace(
    vertices=CORNERS, faces=np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 9]])
)


def test_starts_as_arrays_volumes_meshes_and_balls(pair):
    volume, starts, _ = pair
    mask = starts == 4
    by_mask = segment(volume, start=mask, **BALL)
    by_volume = segment(volume, start=volume.with_array(mask.astype(np.uint8)), **BALL)
    assert by_volume.psi.tobytes() == by_mask.psi.tobytes()
    text = segment(volume, start="ball:14,14,13,5", **BALL)
    assert segment(volume, start=[(14, 14, 13, 5)], **BALL).psi.tobytes() == text.psi.tobytes()
    two = segment(volume, start=[(14, 14, 13, 5), (29, 14, 13, 4)], **BALL)
    assert (
        two.psi.tobytes()
        == segment(volume, start=("ball:14,14,13,5", "ball:29,14,13,4"), **BALL).psi.tobytes()
    )
    by_mesh = segment(volume, start=text.surface, max_steps=0, levels=1)
    assert dice(by_mesh.labels > 0, text.labels > 0) > 0.97
    inside = np.zeros(SHAPE, bool)
    inside[:, :, :22] = True
    held = segment(volume, start="ball:14,14,13,5", mask=inside, max_steps=30)
    assert held.labels.any() and not held.labels[~inside].any()
    assert by_mask.report["config"]["start"] == "given as an array"
    with pytest.raises(InputError, match="start array: lies outside of the mask"):
        segment(volume, start=mask, mask=~inside & (np.indices(SHAPE)[2] > 35), **BALL)
    learned = segment(
        volume, start="ball:14,14,13,5", energy="likelihood:update=no", foreground=mask, **BALL
    )
    assert learned.terms[0]["inside"]["mean"] == pytest.approx(
        float(volume.array[mask].mean()), abs=0.02
    )


@pytest.mark.parametrize(
    ("start", "error", "words"),
    [
        (np.zeros(SHAPE, bool), InputError, "start: the mask is empty"),
        (np.ones((3, 4, 5)), GeometryError, r"start: an array of shape \(3, 4, 5\) was given"),
        (
            Volume(np.ones(SHAPE, np.uint8), Geometry(SHAPE, (1.0, 1.0, 2.0))),
            GeometryError,
            "on another grid",
        ),
        ([(1, 2, 3)], UsageError, "start: a list was given, expected a text"),
        (OPEN_MESH, InputError, "start: the mesh: .* open edges, expected a closed surface"),
        (WRONG_FACES, InputError, "start: the mesh: its triangles name points"),
        (object(), UsageError, "start: a object was given, expected a text"),
        ([(900, 0, 0, 3)], InputError, "no voxel centre is inside"),
    ],
)
def test_starts_that_are_no_good_are_told_in_one_line(pair, start, error, words):
    with pytest.raises(error, match=words) as caught:
        segment(pair[0], start=start, **BALL)
    assert len(str(caught.value)) < 400


# ------------------------------------------------------------------------------------------------ command line


def test_strict_takes_several_objects(pair, tmp_path, capsys):
    volume, starts, _ = pair
    io.write(volume, tmp_path / "cells.nii.gz")
    io.write_labels(volume.with_array(starts.astype(np.uint16)), tmp_path / "starts.nii.gz")
    words = [
        str(tmp_path / "cells.nii.gz"),
        "--objects",
        str(tmp_path / "starts.nii.gz"),
        "--max-steps",
        "12",
    ]
    out = tmp_path / "out"
    levels = ["--levels", "2", "--edit", "step=3 smoothness=0.3"]
    assert execute(["segment", *words, *levels, "-o", str(out), "--strict", "--quiet"]) == 4
    assert "object 4: max-steps" in capsys.readouterr().err
    names = {path.name for path in out.iterdir()}
    assert {
        "cells_surface_4.ply",
        "cells_surface_300.ply",
        "cells_objects.csv",
        "cells_seg.nii.gz",
    } <= names


def test_an_object_that_fills_the_volume_is_told_and_the_others_are_written(tmp_path, capsys):
    image = np.zeros((16, 16, 30), np.float32)
    image[4:12, 4:12, 20:26] = 1.0
    starts = np.zeros(image.shape, np.uint16)
    starts[6:10, 6:10, 21:25] = 2
    volume = Volume.from_array(image)
    io.write(volume, tmp_path / "a.nii.gz")
    io.write_labels(volume.with_array(starts), tmp_path / "s.nii.gz")
    words = [
        str(tmp_path / "a.nii.gz"),
        "--objects",
        str(tmp_path / "s.nii.gz"),
        "--energy",
        "threshold:,5",
    ]
    assert (
        execute(["segment", *words, "-o", str(tmp_path / "out"), "--quiet", "--max-steps", "200"])
        == 5
    )
    assert "filled" in capsys.readouterr().err
