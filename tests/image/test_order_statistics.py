"""Percentiles of parts have the bytes of numpy's of the whole array."""

import numpy as np
import pytest

from accelsurf.image.percentiles import FloatCounts, IntegerCounts

Q = [0, 0.5, 13.7, 50, 99.5, 99.99, 100.0]
FLOATS = {
    "one": [3.5],
    "two": [-1.0, 2.0],
    "zeros of both signs": [-0.0, 0.0, -0.0, 0.0, 1.0, -1.0, 0.0],
    "tiny": [1e-45, -1e-45, 1e-38, 0.0, -1e-40, 3e-39],
    "huge": [3e38, -3e38, 1e30, -1e30, 5.0],
    "ties": [2.0] * 50 + [1.0] * 7 + [-4.25] * 9,
    "negative": -np.random.default_rng(1).gamma(2.0, 3.0, 999),
    "close": 1000.0 + 1e-3 * np.random.default_rng(2).normal(size=4321),
    "many": np.random.default_rng(3).normal(0, 50, 20001),
}


def parts_of(values, count=7):
    return [part.reshape(1, 1, -1) for part in np.array_split(values, count) if part.size]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("values", FLOATS.values(), ids=FLOATS)
def test_floats(values):
    array = np.asarray(values, np.float32)
    counts = FloatCounts(lambda: parts_of(array))
    for part in parts_of(array):
        counts.add(part)
    assert counts.size == array.size
    np.testing.assert_array_equal(counts.at(np.arange(array.size)), np.sort(array))
    np.testing.assert_array_equal(counts.extremes, [array.min(), array.max()])
    assert not np.signbit(counts.at(np.arange(array.size))[np.sort(array) == 0]).any(), (
        "there is one zero"
    )
    with np.errstate(over="ignore", invalid="ignore"):
        assert_percentiles(counts, array)


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int8, np.uint16, np.int16, ">i2"])
def test_integers(dtype):
    dtype = np.dtype(dtype)
    rng = np.random.default_rng(4)
    array = rng.integers(
        -300 if dtype.kind == "i" and dtype.itemsize == 2 else 0,
        2 if dtype.kind == "b" else 90,
        1234,
    )
    array = array.astype(dtype)
    counts = IntegerCounts(dtype)
    for part in parts_of(array):
        counts.add(part)
    np.testing.assert_array_equal(
        counts.at(np.arange(array.size)), np.sort(array).astype(np.float32)
    )
    assert_percentiles(counts, array.astype(np.float32))


def assert_percentiles(counts, array):
    def scaled(values):
        return (values - np.float32(0.3)) * np.float32(0.011)

    for q in (Q, tuple(Q), *Q):
        for mapped, want in ((lambda v: v, array), (scaled, scaled(array))):
            got, expected = counts.percentiles(q, mapped), np.percentile(want, q)
            assert np.asarray(got).dtype == np.asarray(expected).dtype
            np.testing.assert_array_equal(got, expected)


def test_floats_are_read_again_only_for_what_is_new():
    array = np.random.default_rng(5).normal(0, 1, 5000).astype(np.float32)
    times = []

    def parts():
        times.append(1)
        return parts_of(array)

    counts = FloatCounts(parts)
    for part in parts_of(array):
        counts.add(part)
    counts.percentiles([0.5, 99.5])
    assert len(times) == 1
    counts.percentiles([0.5, 99.5]), counts.extremes
    assert len(times) == 1
    counts.percentiles(50)
    assert len(times) == 2


def test_what_can_be_counted_by_value():
    can = [np.dtype(d) for d in (np.bool_, np.uint8, np.int8, np.uint16, np.int16)]
    cannot = [np.dtype(d) for d in (np.int32, np.uint32, np.float16, np.float32)]
    assert all(map(IntegerCounts.can_count, can)) and not any(map(IntegerCounts.can_count, cannot))
