"""Values of images and settings that nothing can be computed with: named errors, and no warning of numpy."""

import numpy as np
import pytest

from accelsurf import segment, segment_objects
from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.settings.entry import entry_of
from accelsurf.settings.run_config import RunConfig


def ball(dtype=np.float32):
    z, y, x = np.indices((12, 12, 12)) - 5.5
    return (100.0 / (1 + np.exp(z * z + y * y + x * x - 16.0))).astype(dtype)


def run(image, **options):
    return segment(
        image,
        **{"start": "ball:5.5,5.5,5.5,3", "max_steps": 2, "threads": 1, "levels": 1, **options},
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda a: a.__setitem__((1, 2, 3), np.finfo(np.float32).max),
            r"1 voxel is \(first at index x=3, y=2, z=1\)",
        ),
        (lambda a: a.__setitem__(slice(0, 6), -3e38), "864 voxels are"),
        (lambda a: np.multiply(a, 3e38 / 100, out=a), "beyond 1e\\+30"),
        (lambda a: np.multiply(a, 1e-44, out=a), "a range of at least 1e-30"),
        (lambda a: a.__setitem__((1, 2, 3), 1e25), "times their range"),
        (lambda a: a.__setitem__((1, 2, 3), np.nan), "not finite"),
    ],
)
def test_values_that_are_none(change, words):
    image = ball()
    with np.errstate(all="ignore"):
        change(image)
    with pytest.raises(InputError, match=words) as caught:
        run(image)
    assert caught.value.hint


@pytest.mark.parametrize("factor", [1e-20, 1e-3, 1e20])
def test_values_of_other_units_are_segmented(factor):
    result = run((ball(np.float64) * factor).astype(np.float32))
    assert result.labels.any()


def test_the_mask_of_a_masked_array_is_not_ignored():
    image = np.ma.masked_greater(ball(), 90.0)
    for given in (image, image[5]):
        with pytest.raises(
            InputError, match=r"a masked array with \d+ masked of \d+ values"
        ) as caught:
            run(given)
        assert "filled" in caught.value.hint
    with pytest.raises(InputError, match="masked array"):
        Volume(image, Geometry((12, 12, 12), (1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="mask: a masked array"):
        run(ball(), mask=np.ma.masked_array(np.ones((12, 12, 12)), mask=image.mask))
    with pytest.raises(InputError, match="masked array"):
        segment_objects(ball(), np.ma.masked_array(np.ones((12, 12, 12), int), mask=image.mask))
    nothing_masked = run(np.ma.masked_array(ball()))
    np.testing.assert_array_equal(nothing_masked.labels, run(ball()).labels)


NUMBERS = [
    key
    for key, field in RunConfig.model_fields.items()
    if "float" in str(field.annotation) and key != "edit"
]


@pytest.mark.sampled
@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e-308", "nan", "inf", "1e400"])
@pytest.mark.parametrize("key", NUMBERS)
def test_each_number_is_used_or_refused_by_name(key, value):
    with pytest.raises(UsageError) as caught:
        RunConfig(**{key: value})
    assert key in caught.value.message and caught.value.hint and len(caught.value.message) < 300
    assert entry_of(RunConfig.model_fields[key])


@pytest.mark.parametrize(
    "options",
    [
        {"presmooth": 1e12},
        {"presmooth": "999999999vox"},
        {"closing": 1e12},
        {"clip": "5,5"},
        {"clip": ","},
        {"clip": "nan,"},
        {"energy": "geodesic:scale=1e12 + chan-vese"},
        {"energy": "chan-vese + 1e300*area"},
        {"energy": "threshold:1e300,"},
        {"start": "ball:1e300,0,0,1"},
        {"roi": "0,0,0,1e300,1,1"},
        {"spacing": 1e300},
        {"spacing": 1e-300},
        {"edit": "step=1 smoothness=1e300"},
        {"edge_scale": 1e9, "energy": "geodesic"},
    ],
    ids=str,
)
def test_lengths_beyond_every_image_are_refused(options):
    with pytest.raises(AccelsurfError) as caught:
        run(ball(), **options)
    assert caught.value.exit_code in (2, 3) and caught.value.hint


@pytest.mark.sampled
@pytest.mark.parametrize(
    "key",
    [
        *(
            "constant-density:k",
            "constant-density:lam",
            "constant-density:rho",
            "flowable-mass:gravity",
        ),
        *("smoothness", "balance", "friction", "diffusion", "noise"),
    ],
)
@pytest.mark.parametrize("value", ["high", "low"])
def test_the_largest_and_smallest_numbers_make_no_warning(key, value):
    # Warnings are errors in these tests.
    ends = {"high": 20.0, "low": 0.1} if key.endswith(":k") else {"high": 1e12, "low": 1e-18}
    flow = {"flow": f"{key}={ends[value]}"} if ":" in key else {"flow": "constant-density"}
    given = flow if ":" in key else {**flow, key: ends[value]}
    try:
        result = run(ball(), seed=1, **given)
    except AccelsurfError as error:
        assert error.hint
    else:
        assert np.isfinite(result.psi).all()
