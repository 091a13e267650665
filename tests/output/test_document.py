"""The report: every key there, with and without a result, as strict JSON."""

import json
from types import SimpleNamespace

import numpy as np

from accelsurf.errors import InputError
from accelsurf.evolution.loop import Stop
from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.pyramid import Level
from accelsurf.measure.intervals import Estimates
from accelsurf.measure.likely import Quality
from accelsurf.output import document
from accelsurf.settings.run_config import RunConfig
from tests.support.records import step_record

KEYS = {
    *(
        "schema_version",
        "status",
        "exit_code",
        "error",
        "versions",
        "argv",
        "config",
        "input",
        "seed",
        "threads",
    ),
    *(
        "stop",
        "levels",
        "energy",
        "mass",
        "seconds",
        "peak_rss_mb",
        "volume_mm3",
        "area_mm2",
        "components",
    ),
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
        window=None,
        given=(),
        run_history=[step_record(0), step_record(1), step_record(2, kinetic=0.25)],
        estimates=Estimates(1.0, 2.0, None),
        intervals=None,
        quality=Quality(
            probability=0.75,
            next_click=(1.0, 2.0, 3.0),
            next_uncertainty=0.5,
            rim_fraction=0.1,
            border_fraction=0.25,
            contrast=0.5,
            no_edge_fraction=0.125,
            evidence=0.5,
            clicked=0.0,
            beyond_clicks=None,
            inside_like=0.25,
            drift=0.1,
            compactness=0.9,
            parts_beyond_necks=1,
            growth=2.0,
            late_growth=0.01,
            unlike_learned=None,
            leaked=False,
            level_overlap=None,
            size_spread=None,
            correction=None,
            unchanged=None,
            taken=None,
            disagreement=None,
            plateaus=(),
            warnings=(),
            notes=("border: 25% of it",),
        ),
    )
    return SimpleNamespace(**{**values, **changes})


def test_every_key_is_there_with_and_without_a_result():
    full = document.build_report(
        status="ok",
        exit_code=0,
        argv=["accelsurf", "segment"],
        config=RunConfig(seed=4, threads=2),
        source=document.describe_input(
            "scan.nii", geometry=Geometry((5, 4, 3), (2.0, 1.0, 0.5)), checksum="abc"
        ),
        result=finished(),
        seconds={"load": 0.5, "total": 3.0},
        warnings=["from outside"],
    )
    assert KEYS <= set(full)
    assert full["energy"] == {
        **{
            "name": "chan-vese",
            "first": 100.0,
            "last": 100.0 / 3,
            "kinetic_last": 0.25,
            "mass_potential_last": 0.0,
        },
        **{
            "friction_work": 0.5,
            "smoothing_work": 0.25,
            "noise_work": 0.0,
            "steps_of_corrections": 0,
        },
        "terms": [{"term": "chan-vese", "weight": 1.0, "balance": 1.0}],
    }
    assert full["resolved_settings"] == {"presmooth_mm": 0.5}
    assert full["mass"] is None  # constant density conserves none
    heavy = finished(config=RunConfig(flow="flowable-mass:gravity=1"))
    flowable = document.build_report(status="ok", exit_code=0, result=heavy)
    assert (
        flowable["mass"]["first"] == flowable["mass"]["last"] == 3.0
        and flowable["mass"]["correction"] == 0.001
    )
    assert "clamped" in flowable["mass"]["cure"]
    assert full["stop"] == {
        "reason": "converged",
        "steps": 2,
        "time": 0.2,
        "message": "it moved no more",
    }
    assert full["seconds"] == {
        **{
            "load": 0.5,
            "start": 0.1,
            "evolve": 2.0,
            "refine": None,
            "mesh": None,
            "write": None,
            "total": 3.0,
        }
    }
    assert full["warnings"] == ["from the run", "from outside"]
    assert (full["seed"], full["threads"]) == (4, 2)
    assert full["input"]["size"] == [3, 4, 5] and full["input"]["sha256"] == "abc"
    assert full["peak_rss_mb"] is None or full["peak_rss_mb"] > 10

    failed = document.build_report(
        status="failed", exit_code=3, error=document.describe_error(InputError("no", "yes"))
    )
    assert set(failed) == set(full)
    assert failed["error"] == {"type": "InputError", "message": "no", "hint": "yes"}
    assert failed["stop"] is None and failed["config"] is None
    for contents in (full, failed):
        assert json.loads(document.report_json(contents)) == contents


def test_config_in_the_report_makes_the_same_run_again():
    config = RunConfig(
        start=("ball:1,2,3,4", "center"), friction=0.5, mesh="stl,ply", smoothness=0.1 + 0.2
    )
    contents = json.loads(
        document.report_json(document.build_report(status="ok", exit_code=0, config=config))
    )
    assert RunConfig(**contents["config"]) == config


def test_unexpected_error_is_one_line_with_its_type():
    entry = document.describe_error(ZeroDivisionError("float division\nby zero"))
    assert entry["type"] == "ZeroDivisionError" and entry["message"] == "float division by zero"
    assert "--debug" in entry["hint"]
    assert "--resume" in document.describe_error(KeyboardInterrupt())["hint"]


def test_json_is_strict_and_takes_numpy():
    text = document.report_json(
        {"a": np.float32(0.5), "b": float("inf"), "c": (1, np.int64(2)), "d": np.eye(2), "é": True}
    )
    assert json.loads(text) == {"a": 0.5, "b": None, "c": [1, 2], "d": [[1, 0], [0, 1]], "é": True}
    assert "Infinity" not in text


def test_describe_output_has_the_checksum_of_the_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"abc")
    entry = document.describe_output(path, "trace")
    assert entry["sha256"] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert (entry["path"], entry["kind"]) == (str(path), "trace")
