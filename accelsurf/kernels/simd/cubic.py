"""Cubic interpolation on 4 x 4 x 4 nodes in vector instructions: the innermost work of every step.

The compiler does not find this: each row of four neighbours along x is one load, and the weights of an axis
are one vector. Written as numba intrinsics, with a plain form of the same for the interpreter (`NUMBA_DISABLE_JIT`).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from accelsurf.kernels._jit import FASTMATH

_FLAGS = tuple(sorted(FASTMATH))
_F32 = ir.FloatType()
_VECTOR = ir.VectorType(_F32, 4)

#: Lagrange's weights of nodes 0 .. 3 at u are scale (u - r0)(u - r1)(u - r2), their slopes (a u + b) u + c.
_ROOTS = ((1.0, 0.0, 0.0, 0.0), (2.0, 2.0, 1.0, 1.0), (3.0, 3.0, 3.0, 2.0))
_SCALE = (-1.0 / 6.0, 0.5, -0.5, 1.0 / 6.0)
_SLOPE = ((-0.5, 1.5, -1.5, 0.5), (2.0, -5.0, 4.0, -1.0), (-11.0 / 6.0, 3.0, -1.5, 1.0 / 3.0))


def _constant(values: tuple[float, ...]) -> ir.Constant:
    return ir.Constant(_VECTOR, [float(np.float32(v)) for v in values])


class _Emitter:
    """Emits the arithmetic of an interpolation into the function that numba is building."""

    def __init__(self, builder: Any) -> None:
        self.b = builder

    def broadcast(self, scalar: Any) -> Any:
        first = self.b.insert_element(
            ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
        )
        return self.lane(first, 0)

    def lane(self, vector: Any, i: int) -> Any:
        """All lanes set to lane ``i``."""
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), [i] * 4)
        return self.b.shuffle_vector(vector, ir.Constant(_VECTOR, ir.Undefined), mask)

    def mul(self, a: Any, b: Any) -> Any:
        return self.b.fmul(a, b, flags=_FLAGS)

    def add(self, a: Any, b: Any) -> Any:
        return self.b.fadd(a, b, flags=_FLAGS)

    def weights(self, u: Any) -> Any:
        u = self.broadcast(u)
        r0, r1, r2 = (self.b.fsub(u, _constant(roots), flags=_FLAGS) for roots in _ROOTS)
        return self.mul(self.mul(self.mul(r0, _constant(_SCALE)), r1), r2)

    def slopes(self, u: Any) -> Any:
        u = self.broadcast(u)
        a, b, c = (_constant(v) for v in _SLOPE)
        return self.add(self.mul(self.add(self.mul(a, u), b), u), c)

    def combined(self, vectors: list[Any], weights: Any) -> Any:
        """Sum of the vectors by the four weights."""
        total = self.mul(vectors[0], self.lane(weights, 0))
        for i in range(1, 4):
            total = self.add(total, self.mul(vectors[i], self.lane(weights, i)))
        return total

    def dot(self, a: Any, b: Any) -> Any:
        """Sum over the lanes of a x b, in a fixed order: (0 + 2) + (1 + 3)."""
        product = self.mul(a, b)
        lanes = [self.b.extract_element(product, ir.Constant(ir.IntType(32), i)) for i in range(4)]
        return self.b.fadd(self.b.fadd(lanes[0], lanes[2]), self.b.fadd(lanes[1], lanes[3]))

    def load_four(self, data: Any, at: Any) -> Any:
        pointer = self.b.bitcast(self.b.gep(data, [at]), _VECTOR.as_pointer())
        return self.b.load(pointer, align=4)


def _plain_weights(u: float) -> np.ndarray:
    r0, r1, r2 = (u - np.array(roots) for roots in _ROOTS)
    return np.array(_SCALE) * r0 * r1 * r2


def _plain_slopes(u: float) -> np.ndarray:
    a, b, c = (np.array(v) for v in _SLOPE)
    return (a * u + b) * u + c


def plain_cubic(
    array: Any, at: int, sy: int, sz: int, uz: float, uy: float, ux: float
) -> tuple[float, ...]:
    """`cubic` for the interpreter."""
    nodes = np.array(
        [array[at + i * sz + j * sy : at + i * sz + j * sy + 4] for i in range(4) for j in range(4)]
    )
    nodes = nodes.reshape(4, 4, 4).astype(np.float64)
    (z, y, x), (dz, dy, dx) = (
        [form(u) for u in (uz, uy, ux)] for form in (_plain_weights, _plain_slopes)
    )
    return tuple(
        float(np.einsum("ijk,i,j,k", nodes, *w))
        for w in ((z, y, x), (dz, y, x), (z, dy, x), (z, y, dx))
    )


def plain_cubic_value(
    array: Any, at: int, sy: int, sz: int, uz: float, uy: float, ux: float
) -> float:
    """`cubic_value` for the interpreter."""
    return plain_cubic(array, at, sy, sz, uz, uy, ux)[0]


def plain_cubic_rows(values: Any, rows: Any, uz: float, uy: float, ux: float) -> float:
    """`cubic_rows` for the interpreter."""
    nodes = np.array([values[r : r + 4] for r in rows[:16]]).reshape(4, 4, 4).astype(np.float64)
    return float(np.einsum("ijk,i,j,k", nodes, *(_plain_weights(u) for u in (uz, uy, ux))))


def _check(array: Any, dtype: Any) -> None:
    """Anything but a contiguous array of ``dtype`` would be read as if it were one."""
    if not (isinstance(array, types.Array) and array.dtype == dtype and array.layout == "C"):
        raise numba.TypingError(f"contiguous {dtype} expected, not {array}")


@intrinsic
def _cubic(typing_context, array, at, sy, sz, uz, uy, ux):
    _check(array, types.float32)
    signature = types.UniTuple(types.float32, 4)(
        array, types.intp, types.intp, types.intp, types.float32, types.float32, types.float32
    )

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        e = _Emitter(builder)
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        at, sy, sz = args[1:4]
        (wz, wy, wx), (gz, gy, gx) = (
            [form(u) for u in args[4:7]] for form in (e.weights, e.slopes)
        )
        values, slopes = [], []
        for _ in range(4):
            rows = []
            for _ in range(4):
                rows.append(e.load_four(data, at))
                at = builder.add(at, sy)
            at = builder.add(builder.sub(at, builder.mul(sy, ir.Constant(at.type, 4))), sz)
            values.append(e.combined(rows, wy))
            slopes.append(e.combined(rows, gy))
        level, along = e.combined(values, wz), e.combined(values, gz)
        across = e.combined(slopes, wz)
        out = [e.dot(level, wx), e.dot(along, wx), e.dot(across, wx), e.dot(level, gx)]
        return context.make_tuple(builder, sig.return_type, out)

    return signature, generate


@intrinsic
def _cubic_value(typing_context, array, at, sy, sz, uz, uy, ux):
    _check(array, types.float32)
    signature = types.float32(
        array, types.intp, types.intp, types.intp, types.float32, types.float32, types.float32
    )

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        e = _Emitter(builder)
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        at, sy, sz = args[1:4]
        wz, wy, wx = (e.weights(u) for u in args[4:7])
        planes = []
        for _ in range(4):
            row, rows = at, []
            for _ in range(4):
                rows.append(e.load_four(data, row))
                row = builder.add(row, sy)
            planes.append(e.combined(rows, wy))
            at = builder.add(at, sz)
        return e.dot(e.combined(planes, wz), wx)

    return signature, generate


@intrinsic
def _cubic_rows(typing_context, values, rows, uz, uy, ux):
    _check(values, types.float32)
    _check(rows, types.int64)
    signature = types.float32(values, rows, types.float32, types.float32, types.float32)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        e = _Emitter(builder)
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        offsets = context.make_array(sig.args[1])(context, builder, args[1]).data
        wz, wy, wx = (e.weights(u) for u in args[2:5])
        planes = []
        for i in range(4):
            at = [builder.load(cgutils.gep_inbounds(builder, offsets, 4 * i + j)) for j in range(4)]
            planes.append(e.combined([e.load_four(data, a) for a in at], wy))
        return e.dot(e.combined(planes, wz), wx)

    return signature, generate


#: ``cubic(array, at, sy, sz, uz, uy, ux)``: value and slopes (z, y, x) per voxel of the raveled float32 ``array`` at
#: (uz, uy, ux) voxels from node ``at``, the first of four along each axis; strides ``sy`` and ``sz``. No index is
#: checked, not even with NUMBA_BOUNDSCHECK.
cubic: Any = plain_cubic if numba.config.DISABLE_JIT else _cubic
#: ``cubic_value``: the value alone.
cubic_value: Any = plain_cubic_value if numba.config.DISABLE_JIT else _cubic_value
#: ``cubic_rows(values, rows, uz, uy, ux)``: the value alone, the sixteen rows of four nodes beginning at ``rows``
#: (int64, z by z) in float32 ``values``.
cubic_rows: Any = plain_cubic_rows if numba.config.DISABLE_JIT else _cubic_rows
