"""Texts of tables: no spreadsheet takes one for a formula, numbers stay numbers, and each text is known again."""

import csv
import io
import random

import numpy as np
import pytest

from accelsurf.io import label_tables
from accelsurf.io.cells import table_text, text_cell, text_of_cell
from accelsurf.settings.labels import LabelEntry

SIGNS = "=+-@'\t\r ＝＋－＠"


def drawn(draw):
    begin = "".join(draw.choice(SIGNS) for _ in range(draw.randint(0, 4)))
    return begin + draw.choice(["", 'HYPERLINK("http://x","y")', "1+1", "x", "SUM(A1)", "é"])


@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_a_text_is_no_formula_and_comes_back(delimiter):
    draw = random.Random(13)
    texts = [drawn(draw) for _ in range(500)]
    table = table_text(("id", "name"), list(enumerate(texts)), delimiter)
    rows = list(csv.reader(io.StringIO(table, newline=""), delimiter=delimiter))[1:]
    assert len(rows) == len(texts)
    for text, (_, cell) in zip(texts, rows, strict=True):
        begin = cell.lstrip()[:1]
        assert begin not in tuple("=+@＝＋－＠") and cell[:1] not in ("\t", "\r"), text
        assert begin != "-" or cell == "-", text
        assert text_of_cell(cell) == text


def test_numbers_stay_numbers():
    values = [
        -1.5,
        np.float32(-0.25),
        -3,
        np.int16(-7),
        "-1.5",
        "+2e-3",
        "-",
        float("-inf"),
        True,
        None,
    ]
    line = table_text(["v"] * len(values), [values]).splitlines()[1]
    assert line == "-1.5,-0.25,-3,-7,-1.5,+2e-3,-,-inf,1,"


def test_a_label_that_is_called_like_a_formula_is_read_again(tmp_path):
    names = [
        '=HYPERLINK("http://x","y")',
        "@SUM(A1)",
        "+1+cmd|' /C calc'!A0",
        "'=x",
        "'quoted'",
        "-left",
    ]
    entries = [LabelEntry(n, name, (n, 2, 3)) for n, name in enumerate(names, 1)]
    text = label_tables.bids_text(entries)
    assert not any(
        cell.startswith(("=", "@", "+", "-"))
        for line in text.splitlines()
        for cell in line.split("\t")
    )
    (tmp_path / "a.tsv").write_text(text, encoding="utf-8")
    table = label_tables.read_label_table(tmp_path / "a.tsv")
    assert [table[n].name for n in range(1, len(names) + 1)] == names
    assert text_cell("=") == "'="
