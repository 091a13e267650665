"""An entry, with its function in the table of its room, adds a term, a flow, a trace column, a preset or a format of
files: registered in this file, each is found wherever one can look.

Run as a program this file is the command line of accelsurf with the entries: ``python test_one_entry.py segment ...``.
"""

import csv
import io as streams
import json
import os
import struct
import subprocess
import sys
from contextlib import ExitStack
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.api.segment import segment
from accelsurf.energies import ImageEnergy, sample_at_front
from accelsurf.errors import InputError, UsageError
from accelsurf.flows import Gradient
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import channels, headers, meshes
from accelsurf.io.format_functions import FORMAT_FUNCTIONS, FormatFunctions
from accelsurf.io.meshes import MESH_READERS
from accelsurf.measure.surface_mesh import SURFACE_WRITERS
from accelsurf.output.folder import check_outputs
from accelsurf.run.makers import FLOW_MAKERS, TERM_MAKERS, TERM_REACHES
from accelsurf.run.setup import choose_levels, window_reach
from accelsurf.settings.catalogue import help_of
from accelsurf.settings.energy_terms import TERMS, TermSpec, examples
from accelsurf.settings.expression import Number
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_suffixes
from accelsurf.settings.flow_specs import FLOWS, FlowSpec
from accelsurf.settings.mesh_formats import MESH_FORMATS, MeshFormat
from accelsurf.settings.presets import PRESETS, Preset
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.trace_columns import TRACE_COLUMNS, TraceColumn, row_values
from docs.reference.generate import pages


class Brighter(ImageEnergy):
    """U = strength int_inside (1/2 - I), so f = strength (1/2 - I)."""

    def __init__(self, image, strength, alpha):
        super().__init__(image, alpha)
        self.strength = strength

    def value(self, surface, fraction, area):
        sums = self.sums.inside(surface, fraction)
        return self.strength * (
            0.5 * sums.voxels - sums.total
        ) * surface.voxel_volume + self.alpha * float(area.sum())

    def force(self, surface, front, curvature):
        bright = sample_at_front(self.sums.image, surface, front)
        force = np.where(front, self.strength * (0.5 - bright), 0.0)
        return (force + self.alpha * curvature).astype(np.float32)


def make_brighter(inputs):
    strength = inputs.number("strength", inputs.config.balance)
    return Brighter(inputs.image, strength, inputs.alpha), {"strength": strength}


TERM = TermSpec(
    "toy",
    "a toy that wants bright voxels",
    {"strength": Number(0.0, 9.0, low_too=False, help="how much it wants them")},
    uses=("balance",),
    example="toy:strength=2",
    keeps_fine_edges=True,
)
FLOW = FlowSpec(
    "toy-flow",
    "a toy that descends",
    {"blend": Number(0.0, 1.0, help="how much it blends")},
    uses=("friction",),
)
COLUMN = TraceColumn(
    "toy_cells",
    "cells",
    "a toy that counts the band",
    lambda surface, energy, flow: surface.size + 0.25,
)
PRESET = Preset(
    "toy-scan", "Scans of toys.", {"cfl": 0.4}, {"cfl": "toys are slow"}, {"a toy": "it did well"}
)


def parse_toy(path):
    mark, *numbers = struct.unpack("<3s3H3d", path.read_bytes()[:33])
    if mark != b"TOY":
        raise InputError("this is not a toy", "is it the right file?")
    return numbers[:3], numbers[3:]


def read_toy(path, header, available):
    shape, spacing = header
    voxels = np.frombuffer(path.read_bytes()[33:], np.uint8)
    return Volume(voxels.reshape(shape), Geometry(tuple(shape), tuple(spacing)), {}, path)


def write_toy(volume, path):
    start = struct.pack("<3s3H3d", b"TOY", *volume.geometry.shape, *volume.geometry.spacing)
    path.write_bytes(start + volume.array.tobytes())


def toy_mesh(vertices, faces, space, label=None):
    return struct.pack("<2I", len(vertices), len(faces)) + vertices.tobytes() + faces.tobytes()


def read_toy_mesh(content):
    points, triangles = struct.unpack("<2I", content[:8])
    middle = 8 + 24 * points
    vertices = np.frombuffer(content[8:middle]).reshape(-1, 3)
    return vertices, np.frombuffer(content[middle:], np.int32).reshape(triangles, 3)


IMAGE = ImageFormat(
    "toy",
    "a toy that holds bytes",
    (".toy",),
    is_written=True,
    types=("uint8",),
    keeps="spacing",
    distances="nrrd",
)
MESH = MeshFormat("toymesh", "a toy that holds triangles")
REGISTERED = (
    (TERMS, TERM),
    (FLOWS, FLOW),
    (TRACE_COLUMNS, COLUMN),
    (PRESETS, PRESET),
    (IMAGE_FORMATS, IMAGE),
    (MESH_FORMATS, MESH),
)
#: The functions of the entries, each in the table of the room that has them.
FUNCTIONS = (
    (TERM_MAKERS, {"toy": make_brighter}),
    (TERM_REACHES, {"toy": lambda settings, largest: settings.get("strength", 1.0) * largest}),
    (FLOW_MAKERS, {"toy-flow": lambda config: Gradient(config.flow.numbers.get("blend", 0.0))}),
    (FORMAT_FUNCTIONS, {"toy": lambda: FormatFunctions(parse_toy, read_toy, write_toy)}),
    (SURFACE_WRITERS, {"toymesh": toy_mesh}),
    (MESH_READERS, {".toymesh": read_toy_mesh}),
)


def registered():
    stack = ExitStack()
    for table, entry in REGISTERED:
        stack.enter_context(patch.dict(table, {entry.name: entry}))
    for table, functions in FUNCTIONS:
        stack.enter_context(patch.dict(table, functions))
    return stack


@pytest.fixture
def toys():
    with registered():
        yield
    assert not any(entry.name in registry for registry, entry in REGISTERED)


def volume():
    z, y, x = np.indices((16, 20, 24))
    ball = (z - 8) ** 2 + (y - 10) ** 2 + (x - 12) ** 2 < 5**2
    return Volume.from_array((100.0 * ball).astype(np.float32))


ENERGY, START = "toy:strength=2 + 0.1*area", "ball:12,10,8,3vox"


def program(*words, **environment):
    """Output of the command line with the entries, in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=120,
        env={
            **os.environ,
            "COLUMNS": "500",
            "PYTHONPATH": os.pathsep.join(sys.path),
            **environment,
        },
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


# ------------------------------------------------------------------------------------------------------- settings


def test_configuration_and_toml(toys, tmp_path):
    config = RunConfig(energy=ENERGY, flow="toy-flow:blend=0.3")
    path = tmp_path / "run.toml"
    path.write_text(config.to_toml())
    assert RunConfig.from_toml(path) == config
    path.write_text('energy = [{term = "toy", strength = 2}, {term = "area", weight = 0.1}]\n')
    assert RunConfig.from_toml(path).energy == ENERGY


def test_what_it_does_not_take_is_refused_in_the_usual_words(toys):
    with pytest.raises(UsageError, match="a number above 0 and at most 9 for strength of toy"):
        RunConfig(energy="toy:strength=10")
    with pytest.raises(UsageError, match="partition, toy"):
        RunConfig(energy="area")
    with pytest.raises(UsageError, match="sobolev, momentum or toy-flow"):
        RunConfig(flow="toy-flo")
    with pytest.raises(UsageError, match="png, tif, npy or toy"):
        RunConfig(format="toi")
    with pytest.raises(UsageError, match="glb, csv, toymesh"):
        RunConfig(mesh="toimesh")
    with pytest.raises(UsageError, match="fluorescence-nucleus or toy-scan"):
        RunConfig(preset="toy-scam")


def test_its_settings_of_the_run_mean_something_to_it(toys):
    assert RunConfig(energy="toy", balance=2, epsilon=1).unused() == ["epsilon"]
    assert RunConfig(flow="toy-flow", friction=0.5, diffusion=1).unused() == ["diffusion"]


def test_help_schema_and_messages(toys):
    assert help_of("energy").endswith("toy: a toy that wants bright voxels.")
    properties = RunConfig.json_schema()["properties"]
    assert (
        properties["flow"]["description"].endswith("toy-flow: a toy that descends.")
        and "toy that wants" in properties["energy"]["description"]
    )
    assert "ome.zarr, tif, npy, toy, or for one slice png" in help_of("format")
    assert "glb, toymesh;" in help_of("mesh")
    assert "fluorescence-nucleus, toy-scan." in properties["preset"]["description"]
    assert properties["format"]["anyOf"][0]["enum"][-1] == "toy"


def test_what_a_term_says_about_levels_and_its_reach(toys):
    grid = Geometry((96, 96, 96), (1.0, 1.0, 2.0))
    z, y, x = (grid.spacing[a] * (np.arange(96.0, dtype=np.float32) - 48) for a in range(3))
    psi = np.sqrt(z[:, None, None] ** 2 + y[:, None] ** 2 + x**2) - 30
    assert len(choose_levels(RunConfig(), grid, psi, True)) > 1
    assert len(choose_levels(RunConfig(energy="chan-vese + toy"), grid, psi, True)) == 1
    assert window_reach(RunConfig(), grid) == 0
    assert window_reach(RunConfig(energy="chan-vese + toy:strength=3 + 2*toy"), grid) == 6


def test_a_preset(toys):
    assert (
        RunConfig(preset="toy-scan").cfl == 0.4 and RunConfig(preset="toy-scan", cfl=0.3).cfl == 0.3
    )


# -------------------------------------------------------------------------------------------------- file formats


def bytes_volume():
    return Volume(volume().array.astype(np.uint8), Geometry(volume().array.shape, (1.0, 0.5, 0.5)))


def test_an_image_is_read_and_written(toys, tmp_path):
    io.write(bytes_volume(), tmp_path / "ball.toy")
    back = io.read(tmp_path / "ball.toy")
    np.testing.assert_array_equal(back.array, bytes_volume().array)
    assert back.geometry.matches(bytes_volume().geometry)
    assert io.split_name("a/ball.toy") == ("ball", ".toy") and image_suffixes()[-1] == ".toy"
    (only,) = channels.read_channels(tmp_path / "ball.toy")
    np.testing.assert_array_equal(only.array, bytes_volume().array)
    assert not headers.is_anatomical(back.metadata)
    with pytest.raises(UsageError, match=r"values of type float32 given, a \.toy holds uint8"):
        io.write(volume(), tmp_path / "float.toy")
    (tmp_path / "ball.toy").write_bytes(b"TIY" + bytes(99))
    with pytest.raises(InputError, match=r"ball\.toy: this is not a toy"):
        io.read(tmp_path / "ball.toy")


@pytest.mark.parametrize("ending", ["toy", "nii.gz"])
def test_a_run_with_its_files(toys, tmp_path, ending):
    io.write(bytes_volume(), tmp_path / f"ball.{ending}")
    words = ["segment", tmp_path / f"ball.{ending}", "-o", tmp_path, "--start", START, "--save-sdf"]
    words += [
        "--max-steps",
        30,
        "--mesh",
        "ply,toymesh",
        *(() if ending == "toy" else ("--format", "toy")),
    ]
    assert cli.execute([str(word) for word in words]) == 0
    labels = io.read_labels(tmp_path / "ball_seg.toy")
    assert 300 < labels.array.sum() < 700 and labels.geometry.spacing == (1.0, 0.5, 0.5)
    assert io.read(tmp_path / "ball_sdf.nrrd").array.dtype == np.float32
    report = json.loads((tmp_path / "ball_report.json").read_text())
    written = [(entry["kind"], entry["path"].rpartition(".")[2]) for entry in report["outputs"]]
    assert written[:4] == [
        ("labels", "toy"),
        ("surface", "ply"),
        ("surface", "toymesh"),
        ("sdf", "nrrd"),
    ]
    files = (tmp_path / f"ball_surface.{kind}" for kind in ("toymesh", "ply"))
    ours, other = (meshes.voxels_in_mesh(file, labels.geometry) for file in files)
    np.testing.assert_array_equal(ours, other)
    np.testing.assert_array_equal(ours, labels.array > 0)


def test_a_mesh_that_holds_no_contours_is_refused_for_a_slice(toys):
    grid = Geometry((1, 8, 9), (1.0, 1.0, 1.0))
    with pytest.raises(
        UsageError, match="toymesh was given for an image of one slice.*expected vtp, csv"
    ):
        check_outputs(RunConfig(mesh="toymesh"), "toy", grid)


# --------------------------------------------------------------------------------------------------- command line


@pytest.mark.program
def test_help_of_the_command():
    shown = program("segment", "--help-all")
    assert (
        "toy: a toy that wants bright voxels" in shown and "toy-flow: a toy that descends" in shown
    )
    assert ".tif, .dcm, .mgz, .npy or .toy" in shown and "toymesh" in shown and "toy-scan" in shown


def test_info(toys, capsys):
    for topic, said in (
        ("energy-terms", "a toy that wants bright voxels (settings: strength)"),
        ("flows", "a toy that descends (settings: blend)"),
        ("trace-columns", "a toy that counts the band (cells)"),
    ):
        assert cli.execute(["info", topic]) == 0
        assert said in capsys.readouterr().out
    assert cli.execute(["info", "--json"]) == 0
    description = json.loads(capsys.readouterr().out)
    assert (
        "toy" in description["energies"]
        and "toy" in description["energy_terms"]
        and "toy-flow" in description["flows"]
    )
    assert "toy_cells" in description["trace_columns"] and description["presets"]["toy-scan"][
        "settings"
    ] == {"cfl": 0.4}
    assert (
        description["volume_formats"][-1] == ".toy" and description["mesh_formats"][-1] == "toymesh"
    )


def test_a_run_its_report_trace_and_progress(toys, tmp_path, capsys):
    io.write(volume(), tmp_path / "ball.nii.gz")
    words = [
        "segment",
        tmp_path / "ball.nii.gz",
        "-o",
        tmp_path,
        "--energy",
        ENERGY,
        "--flow",
        "toy-flow",
    ]
    assert (
        cli.execute([str(word) for word in (*words, "--start", START, "--progress", "json")]) == 0
    )
    report = json.loads((tmp_path / "ball_report.json").read_text())
    assert report["energy"]["terms"][0] == {"term": "toy", "weight": 1.0, "strength": 2.0}
    assert report["config"]["flow"] == "toy-flow" and report["stop"]["reason"] == "converged"
    rows = list(csv.DictReader(streams.StringIO((tmp_path / "ball_trace.csv").read_text())))
    assert [float(row["toy_cells"]) for row in rows] == [
        int(row["band_cells"]) + 0.25 for row in rows
    ]
    events = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [row["toy_cells"] for row in events if row["event"] == "step"] == [
        float(row["toy_cells"]) for row in rows
    ]


def test_several_objects(toys, tmp_path):
    starts = np.zeros(volume().array.shape, np.uint8)
    starts[7:10, 9:12, 11:14] = 3
    io.write(volume(), tmp_path / "ball.nii.gz")
    io.write_labels(volume().with_array(starts), tmp_path / "starts.nii.gz")
    words = [
        "segment",
        tmp_path / "ball.nii.gz",
        "-o",
        tmp_path,
        "--objects",
        tmp_path / "starts.nii.gz",
    ]
    assert cli.execute([str(word) for word in (*words, "--energy", ENERGY, "--max-steps", 4)]) == 0
    report = json.loads((tmp_path / "ball_report.json").read_text())
    assert report["objects"][0]["terms"][0] == {"term": "toy", "weight": 1.0, "strength": 2.0}
    rows = list(csv.DictReader(streams.StringIO((tmp_path / "ball_trace.csv").read_text())))
    assert [float(row["toy_cells"]) for row in rows] == [
        int(row["band_cells"]) + 0.25 for row in rows
    ]
    assert len(rows) == 5 and rows[0]["object"] == "3"


# --------------------------------------------------------------------------------------------- viewer and documents


@pytest.mark.program
def test_lists_of_the_viewer():
    pytest.importorskip("PySide6")
    shown = program("panel", QT_QPA_PLATFORM="offscreen").split()
    assert "toy:strength=2" in shown and "toy-flow" in shown


def test_lists_of_the_page(toys):
    assert "toy:strength=2" in examples() and "toy-flow" in list(FLOWS)


def test_reference_pages(toys):
    made = pages()
    assert (
        "## toy\n" in made["energy-terms.md"]
        and "how much it wants them" in made["energy-terms.md"]
    )
    assert "## toy-flow\n" in made["flows.md"] and "how much it blends" in made["flows.md"]
    assert "| `toy_cells` | cells | a toy that counts the band |" in made["trace.md"]
    assert "| Acts on | `chan-vese`, `toy` |" in made["settings.md"]
    formats = made["file-formats.md"]
    assert (
        "| `toy` | a toy that holds bytes | `.toy` | uint8; signed distances go to `nrrd` | the spacing |"
        in formats
    )
    assert "| `toymesh` | a toy that holds triangles | yes | no | yes |" in formats
    assert "## toy-scan\n" in made["presets.md"]


# ----------------------------------------------------------------------------------------------------------- registry


def test_a_column_that_came_later_is_empty_in_a_record_that_was_made_before():
    result = segment(volume(), start=START, max_steps=2)
    assert all(row.extra == () for row in result.history)
    with registered():
        rows = [row_values(row) for row in result.history]
    assert [row["toy_cells"] for row in rows] == [None, None, None]


def _panel():
    from PySide6.QtWidgets import QApplication

    from accelsurf.viewer.actions.settings_rows import SettingsFeature
    from accelsurf.viewer.core.status import Status
    from accelsurf.viewer.window.settings_panel import SettingsPanel

    application = QApplication([])
    status = Status.preparing(RunConfig(), "", False)
    scene, session = (
        SimpleNamespace(geometry=volume().geometry, unit="mm"),
        SimpleNamespace(status=status, source=None),
    )
    actions = SimpleNamespace(scene=scene, session=session, folder=None)
    panel = SettingsPanel(actions)
    panel.show_state(SettingsFeature(actions).state(status))
    for row in panel.rows.values():
        if row.choice is not None:
            print(*(row.choice.itemText(place) for place in range(row.choice.count())), sep="\n")
    del panel, application


if __name__ == "__main__":
    with registered():
        if sys.argv[1] == "panel":
            _panel()
        else:
            sys.exit(cli.execute(sys.argv[1:]))
