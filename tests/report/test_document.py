"""Report, trace and pictures: every key there, numbers without loss, pictures that show what they should."""

import csv
import dataclasses
import io
import json
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib import image as mpl_image

from accelsurf.analysis.quality import Quality
from accelsurf.analysis.surface_mesh import extract
from accelsurf.errors import InputError
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.evolution.records import StepRecord, Stop
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation
from accelsurf.grid.pyramid import Level
from accelsurf.report import canvas, document, file_entries, preview, tables
from accelsurf.report.preview_content import PreviewContent
from accelsurf.report.rasterizer import render
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.trace_columns import TRACE_COLUMNS
from tests.support.records import step_record

KEYS = {
    *("schema_version", "status", "exit_code", "error", "versions", "argv", "config", "input", "seed", "threads"),
    *("stop", "levels", "energy", "mass", "seconds", "peak_rss_mb", "volume_mm3", "area_mm2", "components"),
    *("touches_border", "quality", "warnings", "outputs"),
}


def finished(**changes):
    values = dict(
        config=RunConfig(seed=4, threads=2),
        energy="chan-vese",
        history=[step_record(0), step_record(1), step_record(2, kinetic=0.25)],
        stop=Stop("converged", 2, 0.2, "it moved no more"),
        levels=[LevelSummary(Level(0, (1, 1, 1), (5, 4, 3), (2.0, 1.0, 0.5)), 2, "converged")],
        seconds={"start": 0.1, "evolve": 2.0},
        warnings=["from the run"],
        volume_mm3=1.5,
        area_mm2=2.5,
        enclosed_mm2=None,
        length_mm=None,
        components=1,
        touches_border=False,
        terms=[{"term": "chan-vese", "weight": 1.0, "balance": 1.0}],
        resolved_settings={"presmooth_mm": 0.5},
        has_ids=False,
        quality=Quality(0.25, 0.5, 0.125, 1, 2.0, 0.01, None, False, ("border: 25% of it",)),
    )
    return SimpleNamespace(**{**values, **changes})


# ------------------------------------------------------------------------------------------------------------ report


def test_every_key_is_there_with_and_without_a_result():
    full = document.build(
        status="ok",
        exit_code=0,
        argv=["accelsurf", "segment"],
        config=RunConfig(seed=4, threads=2),
        source=file_entries.describe_input("scan.nii", geometry=Geometry((5, 4, 3), (2.0, 1.0, 0.5)), checksum="abc"),
        result=finished(),
        seconds={"load": 0.5, "total": 3.0},
        warnings=["from outside"],
    )
    assert KEYS <= set(full)
    assert full["energy"] == {
        **{"name": "chan-vese", "first": 100.0, "last": 100.0 / 3, "kinetic_last": 0.25, "mass_potential_last": 0.0},
        **{"friction_work": 0.5, "smoothing_work": 0.25, "noise_work": 0.0},
        "terms": [{"term": "chan-vese", "weight": 1.0, "balance": 1.0}],
    }
    assert full["resolved_settings"] == {"presmooth_mm": 0.5}
    assert full["mass"] is None  # constant density conserves none
    heavy = finished(config=RunConfig(flow="flowable-mass", gravity=1))
    flowable = document.build(status="ok", exit_code=0, result=heavy)
    assert flowable["mass"]["first"] == flowable["mass"]["last"] == 3.0 and flowable["mass"]["correction"] == 0.001
    assert "clamped" in flowable["mass"]["cure"]
    assert full["stop"] == {"reason": "converged", "steps": 2, "time": 0.2, "message": "it moved no more"}
    assert full["seconds"] == {"load": 0.5, "start": 0.1, "evolve": 2.0, "mesh": None, "write": None, "total": 3.0}
    assert full["warnings"] == ["from the run", "from outside"]
    assert (full["seed"], full["threads"]) == (4, 2)
    assert full["input"]["size"] == [3, 4, 5] and full["input"]["sha256"] == "abc"
    assert full["peak_rss_mb"] is None or full["peak_rss_mb"] > 10

    failed = document.build(status="failed", exit_code=3, error=document.describe_error(InputError("no", "yes")))
    assert set(failed) == set(full)
    assert failed["error"] == {"type": "InputError", "message": "no", "hint": "yes"}
    assert failed["stop"] is None and failed["config"] is None
    for contents in (full, failed):
        assert json.loads(document.to_json(contents)) == contents


def test_config_in_the_report_makes_the_same_run_again():
    config = RunConfig(start=("ball:1,2,3,4", "center"), friction=0.5, mesh="stl,ply", smoothness=0.1 + 0.2)
    contents = json.loads(document.to_json(document.build(status="ok", exit_code=0, config=config)))
    assert RunConfig(**contents["config"]) == config


def test_unexpected_error_is_one_line_with_its_type():
    entry = document.describe_error(ZeroDivisionError("float division\nby zero"))
    assert entry["type"] == "ZeroDivisionError" and entry["message"] == "float division by zero"
    assert "--debug" in entry["hint"]
    assert document.describe_error(KeyboardInterrupt())["message"] == "KeyboardInterrupt"


def test_json_is_strict_and_takes_numpy():
    text = document.to_json({"a": np.float32(0.5), "b": float("inf"), "c": (1, np.int64(2)), "d": np.eye(2), "é": True})
    assert json.loads(text) == {"a": 0.5, "b": None, "c": [1, 2], "d": [[1, 0], [0, 1]], "é": True}
    assert "Infinity" not in text


def test_describe_output_has_the_checksum_of_the_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"abc")
    entry = file_entries.describe_output(path, "trace")
    assert entry["sha256"] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert (entry["path"], entry["kind"]) == (str(path), "trace")


# ------------------------------------------------------------------------------------------------------------- trace


def test_trace_has_the_columns_of_a_row_in_order_and_loses_no_digit():
    assert (*TRACE_COLUMNS, "extra") == StepRecord._fields
    last = step_record(1, dt=np.float64(1e-17), band_cells=np.int64(7))
    rows = [step_record(0, potential=1 / 3, restarted=True), last]
    text = tables.trace_csv(rows)
    read = list(csv.DictReader(io.StringIO(text)))
    assert tuple(read[0]) == tuple(TRACE_COLUMNS)
    assert float(read[0]["potential"]) == 1 / 3 and read[0]["restarted"] == "1"
    assert float(read[1]["dt"]) == 1e-17 and read[1]["band_cells"] == "7" and read[1]["restarted"] == "0"
    assert text.endswith("\n") and "\r" not in text


# ---------------------------------------------------------------------------------------------------------- pictures


def ball(shape=(12, 16, 20), spacing=(2.0, 1.0, 1.0), direction=None, radius=6.0):
    geometry = Geometry(shape, spacing, (-3.0, 4.0, 5.0), np.eye(3) if direction is None else direction)
    grid = np.meshgrid(*((np.arange(n) - (n - 1) / 2) * h for n, h in zip(shape, spacing, strict=True)), indexing="ij")
    psi = (np.sqrt(sum(g**2 for g in grid)) - radius).astype(np.float32)
    return psi, geometry


def scene(psi, geometry, **changes):
    rows = [step_record(i, restarted=i == 3) for i in range(8)]
    surface = extract(psi, geometry) if (psi < 0).any() else None
    values = dict(image=(psi < 0).astype(np.float32), psi=psi, geometry=geometry, history=rows, surface=surface)
    return PreviewContent(**{**values, "title": "a ball", **changes})


def pixels(png):
    return mpl_image.imread(io.BytesIO(png))[..., :3]


def share_of(picture, color):
    wanted = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return float((np.abs(picture - wanted).max(axis=2) < 0.02).mean())


def test_preview_shows_contour_energies_and_surface():
    picture = pixels(preview.preview_png(scene(*ball())))
    height, width = picture.shape[:2]
    assert share_of(picture[: height // 2], canvas.ORANGE) > 1e-3  # contours, in the upper half
    assert share_of(picture[height // 2 :], canvas.BLUE) > 1e-4  # energy
    assert share_of(picture[height // 2 :], canvas.VERMILION) > 1e-4  # kinetic energy
    corner = picture[height // 2 :, 2 * width // 3 :]
    blue = (corner[..., 2] > corner[..., 0] + 0.2).mean()
    assert blue > 0.1  # the surface


def test_preview_is_the_same_twice_and_keeps_no_pyplot_state():
    made = scene(*ball())
    before = dict(matplotlib.rcParams)
    assert preview.preview_png(made) == preview.preview_png(made)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("reason", ["vanished", "filled"])
def test_preview_of_an_empty_result(reason):
    psi, geometry = ball()
    level = np.full_like(psi, 3.0 if reason == "vanished" else -3.0)
    picture = pixels(preview.preview_png(scene(level, geometry, surface=None)))
    assert share_of(picture, canvas.ORANGE) == 0.0


def test_preview_of_one_slice_and_of_a_gradient_flow():
    psi, geometry = ball(shape=(1, 16, 20))
    rows = [step_record(i, kinetic=0.0) for i in range(3)]
    picture = pixels(preview.preview_png(scene(psi, geometry, history=rows)))
    assert share_of(picture, canvas.ORANGE) > 1e-4
    assert share_of(picture, canvas.VERMILION) == 0.0


def test_preview_without_a_single_step_and_of_a_constant_slice():
    psi, geometry = ball()
    picture = pixels(preview.preview_png(scene(psi, geometry, history=[], image=np.zeros_like(psi))))
    assert share_of(picture[: len(picture) // 2], canvas.ORANGE) > 1e-3  # the contours
    assert share_of(picture[len(picture) // 2 :], canvas.BLUE) < 1e-3  # no curve of the energy, only its axis' label


def test_comparison_has_a_column_for_each_run_and_the_reference():
    psi, geometry = ball()
    first = scene(psi, geometry, reference=(psi < 1).astype(np.uint8))
    png = preview.comparison_png({"gradient": first, "constant-density": scene(psi + 1, geometry)}, "two flows")
    picture = pixels(png)
    middle = picture.shape[1] // 2
    assert share_of(picture[:, :middle], canvas.SKY) > share_of(picture[:, middle:], canvas.SKY)
    assert share_of(picture[:, middle:], canvas.ORANGE) > 1e-4


def test_anatomical_axes_stand_upright_whatever_the_order_of_the_grid():
    # Stored sagittally: index x runs to the back, index y to the feet, index z to the right.
    direction = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    geometry = Geometry((4, 5, 6), (3.0, 2.0, 1.0), (10.0, 20.0, 30.0), direction)
    upright = DisplayOrientation.of(geometry)
    array = np.arange(4 * 5 * 6).reshape(4, 5, 6)
    turned = upright.reorient(array)
    assert turned.shape == (5, 6, 4) and upright.spacing == (2.0, 1.0, 3.0)
    for index in ((0, 0, 0), (4, 5, 3), (1, 2, 3)):
        place = np.argwhere(array == turned[index])[0]
        world = geometry.index_to_world(place)  # x, y, z
        assert [upright.coordinate(axis, index[axis]) for axis in range(3)] == pytest.approx(list(world[::-1]))
    assert upright.names == ("z", "y", "x")


def test_oblique_axes_are_marked_and_start_at_zero():
    c, s = np.cos(0.2), np.sin(0.2)
    turn = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    upright = DisplayOrientation.of(Geometry((4, 5, 6), (1.0, 1.0, 1.0), (9.0, 9.0, 9.0), turn))
    assert upright.names == ("z'", "y'", "x'") and upright.coordinate(2, 0) == 0.0


# ------------------------------------------------------------------------------------------------------------- splat


def test_render_has_the_silhouette_of_a_ball():
    psi, geometry = ball(shape=(24, 24, 24), spacing=(1.0, 1.0, 1.0), radius=8.0)
    surface = extract(psi, geometry)
    picture = render(surface.vertices, surface.faces, size=200)
    covered = picture.pixels[..., 3] > 0.5
    area = covered.sum() * picture.mm_per_pixel**2
    assert area == pytest.approx(np.pi * 8.0**2, rel=0.02)
    assert picture.pixels[100, 100, 3] == 1.0  # no holes
    inner = picture.pixels[70:130, 70:130, 3]
    assert (inner == 1.0).all()


def test_render_hides_what_lies_behind():
    near = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    far = [[x, y, -1] for x, y, _ in near]
    faces = [[0, 1, 2], [0, 2, 3]]
    box = np.array([[-1.5, -1.5, 0], [1.5, 1.5, 0]])
    view = (0.0, -0.001, 1.0)
    alone = render(near, faces, size=64, view=view, box=box)
    both = render(near + far, faces + [[4, 5, 6], [4, 6, 7]], size=64, view=view, box=box)
    swapped = render(far + near, faces + [[4, 5, 6], [4, 6, 7]], size=64, view=view, box=box)
    inner = np.s_[20:44, 20:44]
    assert np.array_equal(alone.pixels[inner], both.pixels[inner])
    assert np.array_equal(both.pixels[inner], swapped.pixels[inner])


def test_render_of_nothing_is_transparent():
    picture = render(np.zeros((0, 3)), np.zeros((0, 3), int), size=16)
    assert picture.pixels.shape == (16, 16, 4) and not picture.pixels.any()


def test_same_box_gives_the_same_scale():
    psi, geometry = ball()
    small = extract(psi, geometry)
    large = extract(psi - 2, geometry)
    scales = {render(s.vertices, s.faces, size=64, box=large.vertices).mm_per_pixel for s in (small, large)}
    assert len(scales) == 1


def test_scene_can_be_changed_for_another_picture():
    made = scene(*ball())
    assert dataclasses.replace(made, title="other").title == "other"
