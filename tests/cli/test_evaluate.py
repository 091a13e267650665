"""accelsurf evaluate: label by label, many pairs, tables."""

import csv
import io as text_io
import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume

SPACING = (2.0, 1.0, 1.0)


def put(path, *labels, spacing=SPACING):
    """Write a map of 4 x 4 x 4 boxes: label i is in box i, where 0 is none."""
    array = np.zeros((8, 8, 40), np.uint16)
    for place, label in enumerate(labels):
        array[2:6, 2:6, 2 + 7 * place : 6 + 7 * place] = label
    path.parent.mkdir(parents=True, exist_ok=True)
    io.write_labels(Volume.from_array(array, spacing), path)
    return path


@pytest.fixture
def pair(tmp_path):
    return put(tmp_path / "pred.nii.gz", 1, 2, 0, 7), put(tmp_path / "ref.nii.gz", 1, 2, 4, 4)


@pytest.fixture
def said(capsys):
    """Run a command; its exit code and what it printed."""

    def run(*words):
        capsys.readouterr()
        code = cli.execute(["evaluate", *map(str, words)])
        out, err = capsys.readouterr()
        return code, out, err

    return run


def rows_of(text):
    return list(csv.DictReader(text_io.StringIO(text)))


def test_several_labels_as_one_object_are_told(pair, said):
    code, out, _ = said(*pair, "--tolerance", "1,2.5")
    values = dict(
        line.split(maxsplit=1) for line in out.splitlines() if not line.startswith("note")
    )
    assert code == 0 and float(values["dice"]) == pytest.approx(6 / 7, rel=1e-5)
    assert values["volume_pred_ml"] == "0.384" and 0 < float(values["surface_dice_1mm"]) < 1
    assert (
        "note: several labels count as one object: 3 of PRED, 3 of REF" in out
        and "surface_dice_2.5mm" in values
    )
    found = json.loads(said(*pair, "--json")[1])
    assert found["dice"] == pytest.approx(6 / 7) and "several labels" in found["notes"][0]
    one = said(f"{pair[0]}@1", f"{pair[1]}@1")[1]
    assert "note" not in one and "dice                       1\n" in one


def test_each_label_alone(pair, said):
    code, out, _ = said(*pair, "--labels", "all", "--json")
    found = {entry["label"]: entry for entry in json.loads(out)["labels"]}
    assert code == 0 and {label: entry["dice"] for label, entry in found.items()} == {
        1: 1,
        2: 1,
        4: 0,
        7: 0,
    }
    assert found[4]["hausdorff_mm"] is None and found[4]["volume_difference_ml"] == -0.256
    code, out, _ = said(*pair, "--labels", "2-4,9")
    assert [line.split()[0] for line in out.splitlines()[1:4]] == ["2", "4", "9"]
    assert "note: label 4: only in REF" in out and "note: label 9: in neither map" in out
    # These ids only, on either side.
    found = json.loads(said(f"{pair[0]}@1,5-9", f"{pair[1]}@2", "--labels", "all", "--json")[1])[
        "labels"
    ]
    assert [entry["label"] for entry in found] == [1, 2, 7]
    assert json.loads(said(f"{pair[0]}@7", f"{pair[1]}@4", "--json")[1])["dice"] == pytest.approx(
        2 / 3
    )


def test_names_of_labels(pair, said, tmp_path):
    (tmp_path / "names.csv").write_text("id,name,color\n1,liver,#ff0000\n4,left kidney,#00ff00\n")
    code, out, _ = said(*pair, "--labels", "all", "--label-table", tmp_path / "names.csv")
    assert code == 0 and out.splitlines()[0].split()[:2] == ["label", "name"]
    assert "liver" in out.splitlines()[1] and "left kidney" in out.splitlines()[3]
    found = json.loads(
        said(*pair, "--labels", "all", "--names", tmp_path / "names.csv", "--json")[1]
    )["labels"]
    assert [entry["name"] for entry in found] == ["liver", "", "left kidney", ""]


def test_folders_are_compared_by_name_and_a_case_that_fails_stops_no_other(tmp_path, said):
    for case, *labels in (("a", 1, 2), ("sub/b", 1, 0), ("wide", 1)):
        put(
            tmp_path / "pred" / f"{case}.nii.gz",
            *labels,
            spacing=SPACING if case != "wide" else (2.0, 1.0, 1.5),
        )
        put(tmp_path / "ref" / f"{case}.nrrd", 1, 2)
    put(tmp_path / "ref" / "missed.nii.gz", 1)
    put(tmp_path / "pred" / "more.nii.gz", 1)
    (tmp_path / "pred" / "broken.nii.gz").write_bytes(b"no image")
    put(tmp_path / "ref" / "broken.nii.gz", 1)
    put(tmp_path / "pred" / ".hidden.nii.gz", 1)
    code, out, err = said(tmp_path / "pred", tmp_path / "ref", "--labels", "all", "--json")
    found = json.loads(out)
    assert code == 9 and found["counts"] == {"cases": 6, "ok": 2, "failed": 4}
    failures = {entry["case"]: entry["failure"] for entry in found["cases"]}
    assert failures["a"] is failures["sub/b"] is None
    assert (
        "grid" in failures["wide"]
        and "prediction" in failures["missed"]
        and "reference" in failures["more"]
    )
    assert "broken.nii.gz" in failures["broken"] and len(err.splitlines()) == 4
    one, two = found["summary"]
    assert (one["mean"]["dice"], one["count"]["dice"]) == (1, 2)
    assert (two["mean"]["dice"], two["median"]["dice"], two["count"]["hd95_mm"]) == (0.5, 0.5, 1)
    code, out, _ = said(tmp_path / "pred", tmp_path / "ref")
    assert code == 9 and "6 cases, 4 failed" in out
    assert [line.split()[0] for line in out.splitlines()[1:6]] == [
        "a",
        "sub/b",
        "mean",
        "median",
        "count",
    ]


def test_a_table_of_pairs(tmp_path, pair, said):
    table = tmp_path / "pairs.csv"
    table.write_text(
        "case,pred,ref\nfirst,pred.nii.gz,ref.nii.gz\n,pred.nii.gz@7,ref.nii.gz@4\n\nlost,no.nii,ref.nii.gz\n"
    )
    code, out, err = said("--pairs", table, "--csv", "-", "--tolerance", "1")
    rows = rows_of(out)
    assert code == 9 and "lost" in err and "no such file" in err
    assert [(row["row"], row["case"]) for row in rows] == [
        ("case", "first"),
        ("case", "pred"),
        ("case", "lost"),
        ("mean", ""),
        ("median", ""),
        ("count", ""),
    ]
    assert float(rows[1]["dice"]) == pytest.approx(2 / 3) and rows[1]["pred"].endswith(
        "pred.nii.gz@7"
    )
    assert rows[2]["status"] == "failed" and rows[2]["dice"] == "" and rows[5]["dice"] == "2"
    assert (
        float(rows[3]["dice"]) == pytest.approx((6 / 7 + 2 / 3) / 2)
        and float(rows[3]["surface_dice_1mm"]) > 0
    )


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("pred,truth\na,b\n", "pred, truth"),
        ("pred,ref\n", "no row"),
        ("pred,ref\na.nii,\n", "line 2"),
        ("pred,ref\na.nii,b.nii,c.nii\n", "line 2"),
        ("pred,ref\na.nii@x,b.nii\n", "line 2"),
        ('pred,ref\n"a.nii,b.nii\n', "quote"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(tmp_path, said, text, fault):
    (tmp_path / "pairs.csv").write_text(text)
    code, out, err = said("--pairs", tmp_path / "pairs.csv")
    assert code == 3 and out == "" and fault in err and len(err.splitlines()) == 2


def test_the_table_is_written_and_replaced_only_when_asked(tmp_path, pair, said):
    file = tmp_path / "found.csv"
    assert said(*pair, "--labels", "all", "--csv", file)[0] == 0
    before = file.read_bytes()
    assert [row["label"] for row in rows_of(before.decode())] == ["1", "2", "4", "7"]
    code, _, err = said(*pair, "--csv", file)
    assert code == 7 and "--overwrite" in err and file.read_bytes() == before
    assert said(*pair, "--csv", file, "--overwrite")[0] == 0
    assert [row["label"] for row in rows_of(file.read_text())] == [""]
    assert said(*pair, "--csv", tmp_path / "no" / "x.csv")[0] == 7


@pytest.mark.parametrize(
    ("words", "code", "fault"),
    [
        (("PRED",), 2, "no REF"),
        ((), 2, "no PRED"),
        (("PRED", "REF", "--pairs", "x.csv"), 2, "--pairs"),
        (("PRED", "REF", "--labels", "1,x"), 2, "'x'"),
        (("PRED", "REF", "--labels", "5-3"), 2, "5-3"),
        (("PRED", "REF", "--tolerance", "-1"), 2, "-1"),
        (("PRED", "REF", "--tolerance", "1,nan"), 2, "nan"),
        (("PRED", "REF", "--json", "--csv", "-"), 2, "--csv"),
        (("PRED", "REF", "--csv", "--json"), 2, "--csv"),
        (("PRED@a", "REF"), 2, "'a'"),
        (("FOLDER", "REF"), 3, "folder"),
        (("FOLDER/empty", "FOLDER/empty"), 3, "no label map"),
        (("PRED", "FOLDER/absent.nii"), 3, "no such file"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(words, code, fault, tmp_path, pair, said):
    (tmp_path / "empty").mkdir()
    names = {"PRED": str(pair[0]), "REF": str(pair[1]), "FOLDER": str(tmp_path)}
    for name, path in names.items():
        words = [word.replace(name, path) for word in words]
    got, out, err = said(*words)
    assert got == code and fault in err and out == "" and len(err.splitlines()) == 2


def test_two_files_of_one_name_in_a_folder_are_refused(tmp_path, said):
    for suffix in ("nii.gz", "nrrd"):
        put(tmp_path / "pred" / f"a.{suffix}", 1)
    put(tmp_path / "ref" / "a.nii.gz", 1)
    code, _, err = said(tmp_path / "pred", tmp_path / "ref")
    assert code == 3 and "two files of one name" in err


@pytest.mark.parametrize("asked", ["250", "250,3", "1,250", "8-99", "250-260,1-2"])
def test_labels_that_a_reference_has_not_are_named(asked, pair, said):
    code, _, err = said(pair[0], f"{pair[1]}@{asked}")
    lacking = [part for part in asked.split(",") if part not in ("1", "1-2")]
    assert code == 3 and f"has no label {', '.join(lacking)}" in err and "there are 1, 2, 4" in err


def test_a_prediction_without_the_label_has_found_nothing(pair, said):
    code, out, err = said(f"{pair[0]}@250", f"{pair[1]}@2", "--json")
    assert code == 0 and json.loads(out)["dice"] == 0.0
    assert "has no label 250, which counts as nothing found; there are 1, 2, 7" in err


def test_objects_that_are_not_in_the_map_are_named(pair, tmp_path, capsys):
    io.write(io.read(pair[0]), tmp_path / "image.nii")
    words = ["segment", str(tmp_path / "image.nii"), "-o", str(tmp_path / "out")]
    for option in ("--objects", "--labels"):
        assert cli.execute([*words, option, f"{pair[0]}@250"]) == 3
        assert "there are 1, 2, 7" in capsys.readouterr().err
