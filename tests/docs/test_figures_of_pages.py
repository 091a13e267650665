"""The figures in README, tutorial and pages are those of the results that are kept."""

import pytest

from benchmarks.pages import FIGURES, agree, compared


@pytest.mark.parametrize(
    "figures", FIGURES, ids=lambda figures: f"{figures.page}, {figures.source}"
)
def test_a_page_has_the_kept_figures(figures):
    for said, value, key in compared(figures):
        assert agree(said, value), (
            f"{figures.page} says {said}, {figures.source} has {value} at {key}"
        )


def test_a_text_that_is_gone_is_an_error():
    with pytest.raises(LookupError, match="README"):
        compared(FIGURES[0]._replace(text="a text that is not there ([0-9]+)"))
