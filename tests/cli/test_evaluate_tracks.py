"""accelsurf evaluate --tracks: folders of the Cell Tracking Challenge."""

import csv
import io as text_io
import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume
from accelsurf.track.output.files import TrackFiles
from accelsurf.track.output.outputs import TrackOutputs
from accelsurf.track.scored_files import table_beside
from tests.support.trackings import dividing_cells

#: Two objects in three frames: 1 is 4 voxels, 2 is 6.
TWO = np.array([[[0, 0, 1, 1, 1, 1, 0, 0, 2, 2, 2, 2, 2, 2, 0, 0]] * 2], np.uint16)
ALONE = "1 0 2 0\n2 0 2 0\n"


def put(folder, frames, lines, *, reference=False):
    """Write a folder of the challenge."""
    inner = folder / "TRA" if reference else folder
    inner.mkdir(parents=True)
    for number, labels in enumerate(frames):
        name = f"man_track{number:03d}.tif" if reference else f"mask{number:03d}.tif"
        io.write(Volume.from_array(labels, (1.0, 1.0, 1.0)), inner / name)
    (inner / ("man_track.txt" if reference else "res_track.txt")).write_text(lines)
    return folder


@pytest.fixture
def reference(tmp_path):
    return put(tmp_path / "01_GT", [TWO] * 3, ALONE, reference=True)


@pytest.fixture
def said(capsys):
    def run(*words):
        capsys.readouterr()
        code = cli.execute(["evaluate", "--tracks", *map(str, words)])
        out, err = capsys.readouterr()
        return code, out, err

    return run


def test_scores_of_a_folder_of_the_challenge(tmp_path, reference, said):
    gap = np.where(TWO == 2, 0, TWO).astype(np.uint16)
    result = put(
        tmp_path / "01_RES",
        [TWO, gap, np.where(TWO == 2, 3, TWO).astype(np.uint16)],
        "1 0 2 0\n2 0 0 0\n3 2 2 2\n",
    )
    code, out, _ = said(result, reference)
    values = dict(row.split() for row in out.splitlines())
    assert code == 0
    assert float(values["SEG"]) == pytest.approx(5 / 6, rel=1e-5)
    assert float(values["DET"]) == pytest.approx(1 - 10 / 60, rel=1e-5)
    assert float(values["TRA"]) == pytest.approx(1 - (10 + 1 + 3) / 66, rel=1e-5)
    assert (values["missing"], values["false_edges"], values["missing_edges"]) == ("1", "1", "2")
    # ids of the challenge change after a gap: the identity of 2 is that of its longer half, here either
    assert values["identity_switches"] == "1"


def test_outlines_of_their_own_are_what_overlap_is_measured_on(tmp_path, reference, said):
    (reference / "SEG").mkdir()
    half = np.where(TWO == 1, 1, 0).astype(np.uint16)
    half[..., 5] = 0
    io.write(Volume.from_array(half, (1.0, 1.0, 1.0)), reference / "SEG" / "man_seg001.tif")
    code, out, _ = said(put(tmp_path / "01_RES", [TWO] * 3, ALONE), reference)
    assert (code, out.splitlines()[0].split()) == (0, ["SEG", "0.75"])
    assert "note: SEG is measured on the 1 frames with outlines of their own" in out


def test_json_and_a_table_of_frames(tmp_path, reference, said):
    result = put(tmp_path / "01_RES", [TWO] * 3, ALONE)
    code, out, _ = said(result, reference, "--json", "--csv", tmp_path / "frames.csv")
    document = json.loads(out)
    assert (code, document["TRA"], document["identities"]) == (0, 1.0, {"1": 1, "2": 2})
    rows = list(csv.DictReader(text_io.StringIO((tmp_path / "frames.csv").read_text())))
    assert rows[2] == {"frame": "2", "reference": "2", "result": "2", "matched": "2", "dice": "1.0"}
    code, out, _ = said(result, reference, "--csv", "-")
    assert out.splitlines()[0] == "frame,reference,result,matched,dice"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("1 0 2\n", "line 1: '1 0 2' given, expected four whole numbers"),
        (
            "1 0 2 0\n2 3 1 0\n",
            "line 2: '2 3 1 0' given, expected a label above 0, and first <= last frame",
        ),
        ("1 0 2 0\n1 0 2 0\n", "line 2: a second track with the label 1"),
        ("a b c d\n", "line 1: 'a b c d' given, expected four whole numbers"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path, reference, said, lines, message):
    code, out, err = said(put(tmp_path / "01_RES", [TWO] * 3, lines), reference)
    assert (code, out) == (3, "")
    assert f"res_track.txt: {message}" in err


def test_sequences_of_other_lengths_grids_and_frames_that_lack(tmp_path, reference, said):
    code, _, err = said(put(tmp_path / "short", [TWO] * 2, "1 0 1 0\n2 0 1 0\n"), reference)
    assert (code, "has 2 frames" in err) == (3, True)
    code, _, err = said(
        put(tmp_path / "wide", [np.concatenate([TWO, TWO], axis=2)] * 3, ALONE), reference
    )
    assert (code, "(1, 2, 32) voxels" in err) == (3, True)
    result = put(tmp_path / "01_RES", [TWO] * 3, ALONE)
    (result / "mask001.tif").unlink()
    code, _, err = said(result, reference)
    assert (code, "the label map of frame 1 is not there" in err) == (3, True)


def test_options_of_label_maps_are_refused(reference, said):
    for words in (("--labels", "all"), ("--tolerance", "1"), ("--pairs", "pairs.csv")):
        code, _, err = said(reference, reference, *words)
        assert (code, f"{words[0]}: has no effect with --tracks" in err) == (2, True)
    assert said(reference)[0] == 2


def test_label_maps_with_time_and_their_table_are_as_the_folder_of_the_challenge(tmp_path, said):
    made = dividing_cells()
    with TrackOutputs(
        tmp_path, "cells", made.sequence, TrackFiles(labels="nii.gz", also=("ctc",))
    ) as outputs:
        for result in made.results:
            outputs.add(result)
        outputs.finish(made.lineage)
    labels, folder = tmp_path / "cells_labels.nii.gz", tmp_path / "cells_RES"
    for pair in ((labels, folder), (folder, labels)):
        code, out, _ = said(*pair)
        values = dict(row.split() for row in out.splitlines())
        assert code == 0
        assert [values[name] for name in ("SEG", "DET", "TRA", "AOGM")] == ["1", "1", "1", "0"]
    (tmp_path / "cells_tracks.csv").unlink()
    code, out, _ = said(labels, folder)
    values = dict(row.split(maxsplit=1) for row in out.splitlines() if not row.startswith("note"))
    assert (
        values["missing_edges"] == "2"
    )  # of the division; a gap can be seen in the label maps themselves
    assert "note: cells_labels.nii.gz: no table of tracks beside it" in out


def test_a_table_that_lacks_a_column_is_refused(tmp_path, reference, said):
    with io.SequenceWriter(
        tmp_path / "a_labels.nii.gz", Volume.from_array(TWO).geometry, (0, 1, 2), "frame", np.uint16
    ) as writer:
        for number in range(3):
            writer.write(number, TWO)
    no_line = (
        "not a line of a table of tracks, whole numbers of frame, id and parent expected\nhint: "
    )
    tables = [("frame,name\n0,1\n", "no column id")]
    # No number, a cell too few, one of 5000 digits, a quote that never ends: nothing that Python says of them is said.
    for number, lines in (
        (2, "0,x"),
        (2, "0"),
        (3, "0,1\n0," + "1" * 5000),
        (1, '0,"1'),
        (2, "0,\u00b2"),
    ):
        tables.append((f"frame,id\n{lines}\n", f"line {number}: {no_line}"))
    for text, message in tables:
        (tmp_path / "a_tracks.csv").write_text(text, encoding="utf-8")
        code, _, err = said(tmp_path / "a_labels.nii.gz", reference)
        assert (code, message in err) == (3, True), err


@pytest.mark.parametrize(
    ("labels", "table"),
    [
        ("a_labels.nii.gz", "a_tracks.csv"),
        ("a_truth.nii.gz", "a_tracks.csv"),
        ("a_truth.nii.gz", "a_truth.csv"),
        ("a_truth.nii.gz", "a_truth_tracks.csv"),
        ("a.tif", "a_tracks.csv"),
    ],
)
def test_the_table_is_found_by_its_name(tmp_path, labels, table):
    (tmp_path / "b_tracks.csv").touch()
    assert table_beside(tmp_path / labels) is None
    (tmp_path / table).touch()
    assert table_beside(tmp_path / labels) == tmp_path / table


def overlap_by_hand(pairs):
    """SEG: the mean, over all outlines, of the Jaccard index with the label that covers more than half of it."""
    values = []
    for result, exact in pairs:
        for label in np.unique(exact[exact > 0]):
            of_it = exact == label
            names, counts = np.unique(result[of_it], return_counts=True)
            best = names[np.argmax(counts)]
            same = np.count_nonzero(of_it & (result == best))
            covers = best != 0 and 2 * counts.max() > np.count_nonzero(of_it)
            either = np.count_nonzero(of_it | (result == best))
            values.append(same / either if covers else 0.0)
    return np.mean(values)


@pytest.mark.parametrize("seed", range(4))
def test_outlines_of_single_slices(seed, tmp_path, reference, said):
    """The challenge has man_seg_TTT_ZZZ.tif for large volumes: the frame, then the slice."""
    draw = np.random.default_rng(seed)
    (reference / "SEG").mkdir()
    frames, pairs = [], []
    for _ in range(3):
        moved = np.roll(TWO, int(draw.integers(0, 2)), axis=int(draw.integers(1, 3)))
        frames.append(moved.astype(np.uint16))
    for frame, plane in {
        (int(draw.integers(3)), int(draw.integers(TWO.shape[0]))) for _ in range(4)
    }:
        exact = np.roll(TWO[plane : plane + 1], int(draw.integers(0, 2)), axis=2).astype(np.uint16)
        if not exact.any():
            continue
        name = (
            f"man_seg_{frame:03d}_{plane:03d}.tif"
            if draw.random() < 0.5
            else f"man_seg{frame}_{plane}.tif"
        )
        io.write(Volume.from_array(exact, (1.0, 1.0, 1.0)), reference / "SEG" / name)
        pairs.append((frames[frame][plane : plane + 1], exact))
    code, out, err = said(put(tmp_path / "01_RES", frames, ALONE), reference)
    assert code == 0, err
    assert float(out.split()[1]) == pytest.approx(overlap_by_hand(pairs), rel=1e-4)
    assert f"SEG is measured on the {len(pairs)} slices with outlines of their own" in out


@pytest.mark.parametrize(
    ("name", "shape", "message"),
    [
        ("man_seg_001_099.tif", None, "of slice 99, the frames have 0 to"),
        ("man_seg_001_000.tif", (1, 3, 4), "of (1, 3, 4) voxels (z, y, x)"),
        ("man_seg001.tif", (2, 3, 4), "of (2, 3, 4) voxels (z, y, x)"),
    ],
)
def test_outlines_of_another_grid_are_refused(name, shape, message, tmp_path, reference, said):
    (reference / "SEG").mkdir()
    array = np.ones(shape or (1, *TWO.shape[1:]), np.uint16)
    io.write(Volume.from_array(array, (1.0, 1.0, 1.0)), reference / "SEG" / name)
    code, _, err = said(put(tmp_path / "01_RES", [TWO] * 3, ALONE), reference)
    assert code == 3 and message in err and name in err


def test_outlines_of_a_frame_and_of_its_slices_are_refused(tmp_path, reference, said):
    (reference / "SEG").mkdir()
    for name, array in (("man_seg001.tif", TWO), ("man_seg_001_000.tif", TWO[:1])):
        io.write(
            Volume.from_array(array.astype(np.uint16), (1.0, 1.0, 1.0)), reference / "SEG" / name
        )
    code, _, err = said(put(tmp_path / "01_RES", [TWO] * 3, ALONE), reference)
    assert code == 3 and "of the whole frame and of single slices" in err
