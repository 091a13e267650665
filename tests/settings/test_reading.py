"""How an image is read: what is given as text, and what of it a format has."""

import pytest

from accelsurf.errors import UsageError
from accelsurf.settings.reading import ReadOptions, spacing_of
from accelsurf.settings.run_config import RunConfig


@pytest.mark.parametrize(
    ("text", "spacing"),
    [
        ("1", (1, 1, 1)),
        ("0.5,0.6,2", (0.5, 0.6, 2)),
        ("200,300,1000nm", (2e-4, 3e-4, 1e-3)),
        ("2um", (2e-3, 2e-3, 2e-3)),
        ("1e-3,1e-3,2e-3 mm", (1e-3, 1e-3, 2e-3)),
        (".5cm", (5, 5, 5)),
    ],
)
def test_spacing_is_in_mm(text, spacing):
    assert spacing_of(text) == pytest.approx(spacing, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["", "1,2", "1,2,3,4", "0", "-1", "1,1,0", "2inch", "nan", "1e9", "mm", "1,,2", "."]
)
def test_what_is_no_spacing_is_refused(text):
    with pytest.raises(UsageError, match="^spacing: "):
        spacing_of(text)
    with pytest.raises(UsageError, match="^spacing: "):
        RunConfig(spacing=text)


def test_settings_say_how_the_image_is_read():
    config = RunConfig(level="auto", spacing=[0.1, 0.2, 0.3], series="3")
    assert config.reading == ReadOptions(level="auto", spacing=(0.1, 0.2, 0.3), series="3")
    assert RunConfig().reading == ReadOptions() and RunConfig(spacing=0.5).reading.spacing == (
        0.5,
        0.5,
        0.5,
    )
