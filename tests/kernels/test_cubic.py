"""Cubic interpolation in vector instructions: against its plain form, Lagrange's formula and polynomials."""

import itertools

import numba
import numpy as np
import pytest

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.simd import cubic as cubic_kernels
from tests.support import reference

pytestmark = pytest.mark.nojit

#: Shapes with room for four nodes along every axis, odd ones, and a single slice that counts four times.
SHAPES = [(7, 9, 8), (4, 4, 4), (5, 4, 7)]

#: Rounding of float32, relative. A weight is wrong by 7 halves of it (three differences, a constant, three products),
#: a slope by less of the sum of its terms; three of them and the twelve sums and products of the combination: 33.
ROUNDING = 17 * float(np.finfo(np.float32).eps)


@kernel
def call_cubic(array, at, sy, sz, uz, uy, ux):
    return cubic_kernels.cubic(array, at, sy, sz, np.float32(uz), np.float32(uy), np.float32(ux))


@kernel
def call_value(array, at, sy, sz, uz, uy, ux):
    return cubic_kernels.cubic_value(
        array, at, sy, sz, np.float32(uz), np.float32(uy), np.float32(ux)
    )


@kernel
def call_rows(values, rows, uz, uy, ux):
    return cubic_kernels.cubic_rows(values, rows, np.float32(uz), np.float32(uy), np.float32(ux))


def places(count, seed):
    """Places among four nodes: the nodes themselves, the middle, and random ones from the first to the last."""
    some = np.random.default_rng(seed).uniform(0, 3, (count, 3)).astype(np.float32)
    return np.concatenate(
        [some, np.array(list(itertools.product((0, 1, 2, 3), repeat=3)), np.float32), [[1.5] * 3]]
    )


def lagrange(nodes, u):
    """(values, bounds), each (4,), of value and slopes at ``u`` among 4 x 4 x 4 nodes, by the monomials.

    A bound is the sum of all terms that are added, without their signs.
    """
    k = np.arange(4)
    coefficients = np.linalg.inv(np.vander(k, increasing=True).astype(float))
    powers = [float(c) ** k for c in u]
    steps = [k * float(c) ** np.maximum(k - 1, 0) for c in u]
    value, bound = [], []
    for along in (None, 0, 1, 2):
        w = [(steps[a] if a == along else powers[a]) @ coefficients for a in range(3)]
        size = [steps[a] @ np.abs(coefficients) if a == along else np.abs(w[a]) for a in range(3)]
        value.append(np.einsum("ijk,i,j,k", nodes, *w))
        bound.append(np.einsum("ijk,i,j,k", np.abs(nodes), *size))
    return np.array(value), np.array(bound)


@pytest.mark.parametrize("shape", SHAPES)
def test_value_and_slopes_as_the_plain_form_and_as_lagranges(shape):
    """At the first and the last cube of the volume too, whose rows end where the array ends."""
    array = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    sz, sy = shape[1] * shape[2], shape[2]
    last = np.array(shape) - 4
    bases = np.concatenate(
        [[(0, 0, 0), last], np.random.default_rng(2).integers(0, last + 1, (5, 3))]
    )
    for base in bases:
        z, y, x = base
        nodes = array[z : z + 4, y : y + 4, x : x + 4].astype(float)
        for u in places(8, 3):
            got = call_cubic(array.ravel(), int(base @ (sz, sy, 1)), sy, sz, *u)
            plain = cubic_kernels.plain_cubic(
                array.ravel(), int(base @ (sz, sy, 1)), sy, sz, *map(float, u)
            )
            want, bound = lagrange(nodes, u)
            assert (np.abs(np.array(got) - want) <= ROUNDING * bound).all()
            assert (
                abs(call_value(array.ravel(), int(base @ (sz, sy, 1)), sy, sz, *u) - want[0])
                <= ROUNDING * bound[0]
            )
            np.testing.assert_allclose(plain, want, rtol=0, atol=1e-12 * bound.max())


@pytest.mark.parametrize("flat", [(0,), (1,), (0, 1)])
def test_a_stride_of_0_takes_a_slice_four_times(flat):
    shape = [1 if a in flat else 6 for a in (0, 1)] + [5]
    array = np.random.default_rng(4).standard_normal(shape).astype(np.float32)
    sz, sy = (0 if 0 in flat else shape[1] * shape[2]), (0 if 1 in flat else shape[2])
    nodes = np.broadcast_to(array[:4, :4, 1:5], (4, 4, 4)).astype(float)
    for u in places(8, 5):
        got = call_cubic(array.ravel(), 1, sy, sz, *u)
        want, bound = lagrange(nodes, u)
        assert (np.abs(np.array(got) - want) <= ROUNDING * bound).all()
        np.testing.assert_allclose(
            cubic_kernels.plain_cubic(array.ravel(), 1, sy, sz, *map(float, u)),
            want,
            atol=1e-12 * bound.max(),
        )


def test_rows_from_anywhere_as_the_plain_form_and_as_lagranges():
    rng = np.random.default_rng(6)
    values = rng.standard_normal(61).astype(np.float32)
    for turn, u in enumerate(places(20, 7)):
        rows = rng.integers(0, values.size - 3, 16)
        if turn == 0:
            rows[:] = values.size - 4  # the last row of all
        nodes = np.array([values[r : r + 4] for r in rows], float).reshape(4, 4, 4)
        want, bound = lagrange(nodes, u)
        assert abs(call_rows(values, rows, *u) - want[0]) <= ROUNDING * bound[0]
        plain = cubic_kernels.plain_cubic_rows(values, rows, *map(float, u))
        assert plain == pytest.approx(want[0], abs=1e-12 * bound[0])


def test_nodes_come_back():
    """At a node all other weights are 0 exactly."""
    array = np.random.default_rng(8).standard_normal((4, 4, 4)).astype(np.float32)
    for node in np.ndindex(4, 4, 4):
        assert call_cubic(array.ravel(), 0, 4, 16, *node)[0] == pytest.approx(
            array[node], rel=ROUNDING
        )
        assert call_rows(array.ravel(), np.arange(16) * 4, *node) == pytest.approx(
            array[node], rel=ROUNDING
        )


def test_cubic_polynomials_are_exact_with_value_and_gradient():
    z, y, x = np.indices((4, 4, 4)).astype(float) - 1.2

    def polynomial(z, y, x):
        return 0.2 * z**3 - y**3 + x**2 * y + z**3 * y**2 * x - 0.3 * z * x**3 + 2 * z - 1

    nodes = polynomial(z, y, x).astype(np.float32)
    for u in places(30, 9):
        z, y, x = u.astype(float) - 1.2
        want = (
            polynomial(z, y, x),
            0.6 * z**2 + 3 * z**2 * y**2 * x - 0.3 * x**3 + 2,
            -3 * y**2 + x**2 + 2 * z**3 * y * x,
            2 * x * y + z**3 * y**2 - 0.9 * z * x**2,
        )
        _, bound = lagrange(nodes.astype(float), u)
        # The nodes are rounded as well: half a unit more.
        limit = ROUNDING * bound + 0.5 * np.finfo(np.float32).eps * bound
        got = call_cubic(nodes.ravel(), 0, 4, 16, *u)
        assert (np.abs(np.array(got) - want) <= limit).all()
        assert abs(call_rows(nodes.ravel(), np.arange(16) * 4, *u) - want[0]) <= limit[0]


def test_weights_and_slopes_of_the_plain_form_are_those_of_the_axis():
    for u in np.linspace(0, 3, 13):
        base, w, slopes, _ = reference.axis_weights(np.array([1 + u]), 6)
        shift = 1 - base[0]
        np.testing.assert_allclose(cubic_kernels._plain_weights(u + shift), w[0], atol=1e-13)
        np.testing.assert_allclose(cubic_kernels._plain_slopes(u + shift), slopes[0], atol=1e-12)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="the interpreter reads any type")
def test_only_contiguous_float32_is_read():
    """Anything else would be read as if it were: refused when the kernel is compiled."""
    array, rows = np.zeros(64), np.zeros(16, np.int64)
    for wrong in (array, array.astype(np.float32)[::2], array.astype(np.int32)):
        with pytest.raises(numba.TypingError, match="float32"):
            call_cubic(wrong, 0, 4, 16, 1.0, 1.0, 1.0)
        with pytest.raises(numba.TypingError, match="float32"):
            call_rows(wrong, rows, 1.0, 1.0, 1.0)
    with pytest.raises(numba.TypingError, match="int64"):
        call_rows(array.astype(np.float32), rows.astype(np.int32), 1.0, 1.0, 1.0)
