"""The reference pages say what the registries say."""

from functools import cache

import numpy as np
import pytest

from accelsurf.api.segment import segment
from docs.reference import generate
from docs.reference.generate import HERE
from docs.reference.report_keys import REPORT_KEYS

pages = cache(generate.pages)


@pytest.mark.parametrize("name", sorted(path.name for path in HERE.glob("*.md")))
def test_the_committed_page_is_current(name):
    written = (HERE / name).read_text(encoding="utf-8")
    assert written == pages()[name], "run python -m docs.reference.generate"


def test_no_page_is_left_over():
    assert {path.name for path in HERE.glob("*.md")} == set(pages())


def test_every_key_of_a_report_is_explained():
    image = np.zeros((10, 12, 14), np.float32)
    image[3:7, 4:8, 5:9] = 1
    report = segment(image, start="ball:6,6,5,3vox", max_steps=2).report
    nested = ("energy", "resolved_settings")
    keys = {f"{key}.{inner}" for key in nested for inner in report[key]} | set(report) - {"energy"}
    of_corrections = {f"resolved_settings.{key}" for key in ("reach_mm", "moved_mm")}
    assert set(REPORT_KEYS) == keys | of_corrections


def test_the_types_of_the_options_are_current():
    assert generate.OPTIONS.read_text(encoding="utf-8") == generate.options_source(), (
        "run python -m docs.reference.generate"
    )
