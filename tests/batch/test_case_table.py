"""Tables of cases: columns, cells, paths, and what is wrong with a table in one line."""

import pytest

from accelsurf.batch import case_table
from accelsurf.batch.cases import read_cases
from accelsurf.errors import InputError
from accelsurf.settings import budgets


@pytest.fixture
def table(tmp_path):
    def written(text, name="cases.csv", encoding="utf-8"):
        (tmp_path / name).write_text(text, encoding=encoding)
        return case_table.read_cases(tmp_path / name)

    return written


def test_columns_are_settings_and_empty_cells_leave_them(table, tmp_path):
    first, second = table(
        "image,id,reference,inside,max-steps,preset\n"
        'scans/a.nii.gz,one,refs/a.nii.gz,"point:1,2,3; ball:4,5,6,2",20,\n'
        "\n"
        f"{tmp_path}/elsewhere/b.nrrd,,,,,brain-t1\n"
    )
    assert (first.id, first.image, first.reference) == (
        "one",
        tmp_path / "scans/a.nii.gz",
        tmp_path / "refs/a.nii.gz",
    )
    assert first.settings == {"inside": ("point:1,2,3", "ball:4,5,6,2"), "max_steps": "20"}
    assert (second.id, second.image, second.reference) == (
        "b",
        tmp_path / "elsewhere" / "b.nrrd",
        None,
    )
    assert second.settings == {"preset": "brain-t1"} and second.place.endswith("cases.csv, row 4")


def test_files_are_looked_for_in_the_folder_of_the_table(table, tmp_path):
    (case,) = table(
        "image,mask,objects,channel,start,inside\n"
        f'a.nii,m.nii,o.nii@2,t2.nii;{tmp_path}/x/t1.nii,"label:l.nii@3;ball:1,2,3,4",stroke:sub/s.csv\n'
    )
    assert case.settings == {
        "mask": str(tmp_path / "m.nii"),
        "objects": str(tmp_path / "o.nii@2"),
        "channel": (str(tmp_path / "t2.nii"), str(tmp_path / "x" / "t1.nii")),
        "start": (f"label:{tmp_path}/l.nii@3", "ball:1,2,3,4"),
        "inside": (f"stroke:{tmp_path}/sub/s.csv",),
    }


def test_tabs_a_mark_of_utf8_and_capitals(table):
    (case,) = table("Image\tID\tMax_Steps\na.nii\tone\t3\n", "cases.TSV", "utf-8-sig")
    assert (case.id, case.settings) == ("one", {"max_steps": "3"})


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("id,inside\na,b\n", "no column image", "image"),
        (
            "image,smothness\na.nii,1\n",
            "smothness: there is no such column",
            "did you mean smoothness?",
        ),
        (
            "image,max_step\na.nii,1\n",
            "max_step: there is no such column",
            "did you mean max_steps?",
        ),
        ("image,patient\na.nii,1\n", "patient: there is no such column", "leave out"),
        ("image;id\na.nii;b\n", "separated by commas", ".tsv"),
        ("image,id,id\na.nii,b,c\n", "column id is given twice", "leave one"),
        ("image,id\n,b\n", "row 2: no image", "each row"),
        ("image,inside\na.nii,point:1,2,3\n", "row 2: 4 cells, 2 columns", "double quotes"),
        ('image,id\na.nii,"b\n', "not a line of a CSV file", "quote"),
        ("image,id\n", "no row below its header", "row for each"),
        ("", "no column image", "image"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(table, text, message, hint):
    with pytest.raises(InputError, match=message) as error:
        table(text)
    assert hint in error.value.hint and "cases.csv" in error.value.message


def test_text_that_is_no_utf8(table):
    with pytest.raises(InputError, match="not text in UTF-8"):
        table("image\nä.nii\n", encoding="latin-1")


def test_a_table_has_a_budget(tmp_path, monkeypatch):
    path = tmp_path / "cases.csv"
    with path.open("wb") as file:
        file.truncate(budgets.CASES.limit + 1)
    with pytest.raises(InputError, match="at most"):
        case_table.read_cases(path)


def test_a_reference_that_is_missing_is_named_before_anything_runs(tmp_path):
    (tmp_path / "cases.csv").write_text("image,reference\na.nii,absent.nii\n")
    with pytest.raises(InputError, match=r"row 2: the reference .*absent\.nii is missing"):
        read_cases([str(tmp_path / "cases.csv")])


def test_an_id_that_is_given_twice_in_a_table(tmp_path):
    (tmp_path / "cases.csv").write_text("image,id\na.nii,x\nb.nii,y\nc.nii,x\n")
    with pytest.raises(InputError, match=r"the id x is given 2 times: .*row 2 and .*row 4"):
        read_cases([str(tmp_path / "cases.csv")])
