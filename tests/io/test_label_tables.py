"""Label tables of other programs: read, written, and refused line by line."""

import numpy as np
import pytest

from accelsurf.errors import InputError
from accelsurf.io import label_tables
from accelsurf.settings.labels import LabelEntry, LabelTable

ENTRIES = [LabelEntry(1, "liver", (200, 60, 60)), LabelEntry(7, 'left "big" kidney', (0, 128, 255))]
WRITERS = {
    "a.txt": label_tables.itk_snap_text,
    "a.ctbl": label_tables.color_table_text,
    "dseg.tsv": label_tables.bids_text,
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_written_is_read_back(tmp_path, name):
    (tmp_path / name).write_text(WRITERS[name](ENTRIES), encoding="utf-8")
    table = label_tables.read_label_table(tmp_path / name)
    assert [one.id for one in table] == [1, 7] and table[1] == ENTRIES[0]
    assert table[7].color == (0, 128, 255) and table[7].name.replace("'", '"') == ENTRIES[1].name


def test_columns_in_any_order_and_colours_in_two_ways(tmp_path):
    (tmp_path / "a.csv").write_text("name,B,r,g,id\nspleen,3,1,2,4\n\n")
    assert label_tables.read_label_table(tmp_path / "a.csv")[4] == LabelEntry(
        4, "spleen", (1, 2, 3)
    )
    (tmp_path / "b.tsv").write_text(
        "index\tname\tshort\tcolor\n0\tnothing\tBG\tn/a\n2\tspleen\tSP\t#010203\n"
    )
    assert list(label_tables.read_label_table(tmp_path / "b.tsv")) == [
        LabelEntry(2, "spleen", (1, 2, 3))
    ]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.txt", "1 2 3 4 liver", "line 1: IDX R G B A VIS MSH"),
        ("a.ctbl", "# c\n1 liver 1 2 3", "line 2: ID NAME R G B A"),
        ("a.csv", "id,colour\n1,red", "index .or id. and name expected"),
        ("a.csv", "id,name\n1,liver,3", "line 2: 3 cells, 2 expected"),
        ("a.csv", "id,name\nx,liver", "line 2: label 'x'"),
        ("a.csv", "id,name,color\n1,liver,blue", "line 2: colour blue"),
        ("a.csv", "id,name,r,g,b\n1,liver,1,2,300", "numbers of 0 to 255"),
        ("a.csv", "id,name\n1,", "a name of 1 to 64"),
        ("a.nrrd", "NRRD0004\ntype: short\n\nxyz", "no Segment0_Name"),
        ("a.doc", "1 liver", "unknown kind of label table"),
    ],
)
def test_a_line_that_is_not_understood_is_named(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        label_tables.read_label_table(tmp_path / name)


def test_mutated_tables_are_read_or_refused(tmp_path):
    rng = np.random.default_rng(2)
    for name, writer in WRITERS.items():
        content = writer(ENTRIES).encode()
        for _ in range(60):
            damaged = bytearray(content)
            for place in rng.integers(0, len(damaged), 3):
                damaged[place] = rng.integers(0, 256)
            (tmp_path / name).write_bytes(bytes(damaged[: rng.integers(1, len(damaged))]))
            try:
                assert isinstance(label_tables.read_label_table(tmp_path / name), LabelTable)
            except InputError as error:
                assert "\n" not in error.message
