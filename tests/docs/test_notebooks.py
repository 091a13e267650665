"""The notebooks of the documentation run, and show what they say; the site runs them again."""

import json
import re
from pathlib import Path

import matplotlib
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    cells = [
        cell
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == "code"
    ]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells), (
        "clear its outputs"
    )
    names: dict[str, object] = {}
    for cell in cells:
        lines = [line for line in cell["source"] if not line.startswith("%")]
        exec(compile("".join(lines), path.name, "exec"), names)
    printed = capsys.readouterr().out
    print(printed)
    dices = [float(found) for found in re.findall(r"Dice ([\d.]+)$", printed, re.MULTILINE)]
    assert dices[-1] > 0.9 and (path.stem != "mend-a-mask" or dices == sorted(dices))
    matplotlib.pyplot.close("all")
