"""The study against the Lagrangian reference: every section has its rows, and rows of the border come out."""

from __future__ import annotations

from benchmarks import lagrangian, paper_figures


def test_every_section_names_its_rows() -> None:
    for name, section in lagrangian.SECTIONS.items():
        for quick in (True, False):
            rows = list(section(quick))
            assert rows and {row[0] for row in rows} == {name}
            assert len({row[1] for row in rows}) == len(rows)


def test_rows_of_the_border() -> None:
    assert lagrangian.growing_out("descent", 24)["point_voxels"] < 0.15
    row = lagrangian.retreating(32)
    assert 0.0 < row["mean_voxels"] < row["point_voxels"]
    assert lagrangian.told(row).startswith("point_voxels ")


def test_every_figure_of_the_paper_can_be_called() -> None:
    assert (
        all(callable(figure) for figure in paper_figures.FIGURES.values())
        and "exact" in paper_figures.FIGURES
    )
