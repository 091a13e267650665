"""Phantoms of tissue: the wall keeps its volume, speckle has its statistics, the same bytes twice."""

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.errors import UsageError
from accelsurf.phantoms.tissues import phantom_from

SHELL = {
    "tissue": "shell",
    "shape": [36, 36, 40],
    "radius": 13.0,
    "thickness": 4.0,
    "amplitude": 3.0,
}
CELL = {"tissue": "cell", "shape": [48, 48, 1], "radius": 12.0, "thickness": 1.0, "amplitude": 3.0}


def test_the_wall_of_a_beating_shell_keeps_its_volume_and_closes() -> None:
    phantom = phantom_from({**SHELL, "frames": 8, "period": 7.0})
    counts = [int(phantom.truth(n).sum()) for n in range(8)]
    assert max(counts) < 1.04 * min(counts)
    np.testing.assert_array_equal(phantom.truth(0), phantom.truth(7))
    moved = (phantom.truth(0) & phantom.truth(3)).sum() / phantom.truth(0).sum()
    assert moved < 0.7


def test_developed_speckle_has_the_mean_and_the_spread_of_a_rayleigh_distribution() -> None:
    values = {
        **CELL,
        "radius": 20.0,
        "amplitude": 0.0,
        "inside": 100.0,
        "outside": 100.0,
        "shape": [200, 200, 1],
    }
    image = phantom_from(values).frame(0).array
    assert image.mean() == pytest.approx(100.0, rel=0.03)
    assert image.std() / image.mean() == pytest.approx(0.523, rel=0.05)
    smooth = phantom_from({**values, "speckle": 0.0}).frame(0).array
    np.testing.assert_allclose(smooth, 100.0, rtol=1e-5)


def test_coherent_speckle_goes_with_the_material_and_other_speckle_does_not() -> None:
    def likeness(coherence: float) -> float:
        phantom = phantom_from(
            {**CELL, "amplitude": 0.0, "travel": [2.0, 0.0, 0.0], "coherence": coherence}
        )
        first, second = phantom.frame(0).array[0, :, 8:-10], phantom.frame(1).array[0, :, 10:-8]
        return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])

    assert likeness(1.0) > 0.99
    assert likeness(0.0) < likeness(0.6) < 0.95


def test_a_frame_is_the_same_alone_and_the_command_writes_it(tmp_path) -> None:
    text = 'tissue = "wall"\nshape = [24, 24, 24]\nradius = 10.0\nthickness = 3.0\namplitude = 2.0\nframes = 3\n'
    (tmp_path / "tiny.toml").write_text(text)
    assert cli.execute(["synth", str(tmp_path / "tiny.toml"), "-o", str(tmp_path)]) == 0
    values = {
        "tissue": "wall",
        "shape": [24, 24, 24],
        "radius": 10.0,
        "thickness": 3.0,
        "amplitude": 2.0,
        "frames": 3,
    }
    phantom = phantom_from(values)
    written, truth = (io.read_sequence(tmp_path / f"tiny{end}.nii.gz") for end in ("", "_truth"))
    np.testing.assert_array_equal(written.frame(2).array, phantom.frame(2).array)
    np.testing.assert_array_equal(truth.frame(2).array, phantom.truth(2))
    assert [row.id for row in phantom.rows()] == [1, 2] * 3


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"tissue": "bone"}, "tissue"),
        ({"speckle": 1.5}, "speckle"),
        ({"thickness": 12.0}, "radius"),
        ({"shape": [4000, 4000, 4000]}, "voxels"),
        ({"motion": "beat"}, "motion"),
    ],
)
def test_a_recipe_that_cannot_be_is_refused(values: dict, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        phantom_from({**SHELL, **values})
