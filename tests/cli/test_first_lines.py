"""The lines printed at the end of a run: what they say of how it went, and what they leave out."""

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cases.outcome import file_lines
from accelsurf.image.volume import Volume


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """One ball, and two."""
    folder = tmp_path_factory.mktemp("scans")
    z, y, x = np.indices((40, 40, 64)) - np.array([20, 20, 32]).reshape(3, 1, 1, 1)
    random = np.random.default_rng(0)
    for name, places in (("ball", (0,)), ("balls", (-17, 17))):
        image = sum((x - at) ** 2 + y**2 + z**2 < 9**2 for at in places) * 100.0
        noisy = (image + random.normal(0, 5, image.shape)).astype(np.float32)
        io.write(Volume.from_array(noisy), folder / f"{name}.nii")
    return folder


def said_of(capsys, *words):
    assert cli.execute([str(word) for word in words]) == 0
    return capsys.readouterr().out


def test_a_click_gives_no_line_about_the_flow_and_says_what_good_is(scans, tmp_path, capsys):
    out = said_of(
        capsys, "segment", scans / "ball.nii", "-o", tmp_path, "--inside", "ball:32,20,20,4vox"
    )
    assert "flow" not in out and "(Dice 0.8 or more)" in out and "--objects" not in out
    assert "it began as a ball" not in out


@pytest.mark.parametrize(
    ("words", "said"),
    [((), True), (("--start", "center"), False), (("--start", "otsu"), False)],
    ids=lambda value: str(value),
)
def test_a_run_that_was_told_no_place_says_where_it_began(scans, tmp_path, capsys, words, said):
    out = said_of(capsys, "segment", scans / "ball.nii", "-o", tmp_path, "--max-steps", 3, *words)
    assert ("it began as a ball in the middle of the image" in out) is said


def test_two_clicks_that_give_two_parts_are_told_of_objects(scans, tmp_path, capsys):
    clicks = [f"--inside=ball:{x},20,20,4vox" for x in (15, 49)]
    out = said_of(capsys, "segment", scans / "balls.nii", "-o", tmp_path, *clicks)
    assert "2 components" in out and "--objects TABLE" in out


def test_a_run_that_ends_where_it_began_says_so(scans, tmp_path, capsys):
    """Then no step lowered the energy; the trace has its first potential at the end again."""
    for name, click in (("ball", "ball:32,20,20,4vox"), ("balls", "ball:15,20,20,4vox")):
        out = said_of(
            capsys, "segment", scans / f"{name}.nii", "-o", tmp_path / name, "--inside", click
        )
        rows = np.genfromtxt(tmp_path / name / f"{name}_trace.csv", delimiter=",", names=True)
        stayed = rows["returned"][-1] > 0 and rows["potential"][-1] == rows["potential"][0]
        assert ("the first surface stays" in out) == stayed


@pytest.mark.parametrize("first_alone", [True, False])
def test_files_stand_in_one_column(tmp_path, first_alone):
    kinds = ("labels", "surface", "statistics", "statistics", "objects")
    outputs = [{"kind": kind, "path": f"/{number}"} for number, kind in enumerate(kinds)]
    lines = file_lines(outputs, tmp_path / "r_report.json", first_alone)
    assert len(lines) == len(kinds) + 1 - first_alone
    assert {line.index("/") for line in lines} == {13}
    assert lines[-1].startswith("  report ")
