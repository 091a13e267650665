"""Types of kernels' arguments as text: ``int64, float32[2], grid.Grid(int64, ...), (bool, float64)``.

Arrays are C-contiguous and aligned; named tuples are those of the modules of `accelsurf.kernels`.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Sequence

from numba import types
from numba.core.types import Type

_PACKAGE = __name__.rpartition(".")[0]


def to_text(signature: Sequence[Type]) -> str:
    """The text of some types.

    Raises
    ------
    ValueError
        When it would not be read as the same types.

    Examples
    --------
    >>> to_text([types.int64, types.UniTuple(types.float32[:, ::1], 1)])
    'int64, (float32[2],)'
    """
    text = ", ".join(_text(one) for one in signature)
    if from_text(text) != tuple(signature):
        raise ValueError(f"no text says {signature}")
    return text


def from_text(text: str) -> tuple[Type, ...]:
    """The types that a text says.

    Examples
    --------
    >>> from_text("int64, float32[2]")
    (int64, Array(float32, 2, 'C', False, aligned=True))
    """
    read = ast.parse(f"({text},)", mode="eval").body
    assert isinstance(read, ast.Tuple)
    return tuple(_type(node) for node in read.elts)


def _text(one: Type) -> str:
    if isinstance(one, types.Array):
        return f"{one.dtype}[{one.ndim}]"
    if isinstance(one, types.BaseTuple):
        inner = ", ".join(_text(part) for part in one.types)
        if isinstance(one, types.BaseNamedTuple):
            kind = one.instance_class
            return f"{kind.__module__.removeprefix(f'{_PACKAGE}.')}.{kind.__name__}({inner})"
        return f"({inner},)" if len(one.types) == 1 else f"({inner})"
    return str(one)


def _type(node: ast.expr) -> Type:
    match node:
        case ast.Name(id=name):
            return getattr(types, name)
        case ast.Subscript(value=item, slice=ast.Constant(value=int(ndim))):
            return types.Array(_type(item), ndim, "C")
        case ast.Tuple(elts=parts):
            return types.BaseTuple.from_types([_type(part) for part in parts])
        case ast.Call(func=ast.Attribute(value=ast.Name(id=module), attr=name), args=parts):
            kind = getattr(importlib.import_module(f"{_PACKAGE}.{module}"), name)
            return types.BaseTuple.from_types([_type(part) for part in parts], kind)
    raise ValueError(f"types are text such as 'int64, float32[2], (bool, float64)', got {ast.unparse(node)!r}")
