"""States of runs, results and trackings in one container: numpy's .npz with a description in JSON.

A state is a record: nested tuples, dictionaries and further records of numbers and arrays, exact to the last bit.
Nothing that is read can run code: only types that the caller names are made, and arrays hold no objects. A state that
is read has the digest that was written with it, and each field of a record has the type that the record declares.
States of other versions are refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import types as kinds
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from accelsurf.errors import AccelsurfError, InputError
from accelsurf.io.files import bytes_within, write_bytes
from accelsurf.settings import budgets

T = TypeVar("T")
#: Version of the format; raised when it changes, or the meaning of a field of a state does.
FORMAT = 4
_AGAIN = "run from the start again"
_TREE = "tree"
_END = ".npy"
#: Types of the values that a field of a plain type may hold.
_PLAIN: dict[Any, Any] = {
    int: Integral,
    float: Real,
    bool: (bool, np.bool_),
    str: str,
    type(None): type(None),
}


def write_state_file(path: Path, state: Any, types: Mapping[str, type]) -> None:
    """Write a state, completely or not at all; parameters as of `packed_state`.

    Raises
    ------
    OutputError
        When it cannot be written.
    TypeError
        When the state contains anything else than `packed_state` takes.
    """
    write_bytes(path, packed_state(state, types))


def read_state_file(
    path: Path,
    kind: type[T],
    types: Mapping[str, type],
    checked: Callable[[T], T],
    hint: str = _AGAIN,
) -> T:
    """Read a state that `write_state_file` wrote.

    Parameters
    ----------
    path : Path
    kind : type
        Of the state, one of ``types``.
    types : mapping of str to type
        As of `packed_state`.
    checked : callable
        Returns the state, or raises a ValueError where its parts do not fit together.
    hint : str, optional
        Advice where it is refused.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged, of another kind or of another version.
    """
    content = bytes_within(path, budgets.STATE_FILE)
    try:
        state = from_bytes(content, types)
        if not isinstance(state, kind):
            raise ValueError(f"it is no {kind.__name__}")
        return checked(state)
    except InputError as error:
        raise InputError(f"{path}: {error.message}", hint) from None
    except (AccelsurfError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: the state is damaged ({error})", hint) from None


def packed_state(value: Any, types: Mapping[str, type]) -> bytes:
    """Return a state as bytes, in numpy's .npz container.

    Parameters
    ----------
    value : object
        None, bool, int, float, str, arrays of numbers; tuples, lists and dictionaries of these; and records of the
        given types.
    types : mapping of str to type
        Named tuples and dataclasses by the names under which they are written.

    Raises
    ------
    TypeError
        When the state contains anything else.
    """
    arrays: dict[str, np.ndarray] = {}
    names = {kind: name for name, kind in types.items()}
    state = _encode(value, arrays, names)
    about = {
        "format": FORMAT,
        "records": layout_of(types),
        "digest": digest_of(state, arrays),
        "state": state,
    }
    tree = json.dumps(about)
    stream = io.BytesIO()
    np.savez(stream, **{_TREE: np.frombuffer(tree.encode(), np.uint8)}, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def from_bytes(content: bytes, types: Mapping[str, type]) -> Any:
    """Return the state that `packed_state` wrote.

    Raises
    ------
    InputError
        When the content is damaged, or of another format.
    """
    try:
        arrays = stored_arrays(content)
        tree = arrays.pop(_TREE)
        if (tree.ndim, tree.dtype) != (1, np.uint8):
            raise ValueError("its description is missing")
        about = json.loads(tree.tobytes().decode())
        found, layout = about["format"], about["records"]
    except Exception as error:  # whatever zipfile, numpy and json make of damaged bytes
        raise InputError(f"the state is damaged ({error})", _AGAIN) from None
    if found != FORMAT:
        what = (
            f"a state of another version of accelsurf was given (format {found}, expected {FORMAT})"
        )
        raise InputError(what, _AGAIN)
    if layout != layout_of(types):
        raise InputError("a state of another version of accelsurf was given", _AGAIN)
    if about.get("digest") != digest_of(about.get("state"), arrays):
        what = "the state is damaged (its checksum does not fit its content)"
        raise InputError(what, _AGAIN)
    try:
        return _decode(about["state"], arrays, types)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"the state is damaged ({error})", _AGAIN) from None


def stored_arrays(content: bytes) -> dict[str, np.ndarray]:
    """The members of a file by name; an error of any kind where one is no array, or longer than the file.

    `numpy.load` would allocate the announced size before it looks how much there is.
    """
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        # Packed ones are never written: a few bytes of them could fill the memory.
        packed = any(member.compress_type != zipfile.ZIP_STORED for member in members)
        if packed or sum(member.file_size for member in members) > len(content):
            raise ValueError("its arrays are packed, or longer than the file")
        for member in members:
            name = member.filename.removesuffix(_END)
            if name in arrays or name == member.filename:
                raise ValueError(f"{member.filename[:40]} in it is no array, or is there twice")
            arrays[name] = _array(bytearray(archive.read(member)))
    return arrays


def _array(raw: bytearray) -> np.ndarray:
    """The array of a member; it lies in the bytes that are given."""
    head = io.BytesIO(raw[: 1 << 14])
    if np.lib.format.read_magic(head) != (1, 0):
        raise ValueError("an array of another version")
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(head)
    if dtype.hasobject or head.tell() + math.prod(shape) * dtype.itemsize != len(raw):
        raise ValueError(f"an array of {dtype} and shape {shape} is longer or shorter than it says")
    return np.ndarray(shape, dtype, raw, head.tell(), order="F" if is_fortran else "C")


def digest_of(state: Any, arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of a tree and of the arrays that it names."""
    sha = hashlib.sha256(json.dumps(state).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sha.update(f"{name} {array.dtype.str} {arrays[name].shape} ".encode())
        sha.update(array.data if array.size else b"")
    return sha.hexdigest()


def _encode(value: Any, arrays: dict[str, np.ndarray], names: Mapping[type, str]) -> Any:
    if (
        value is None
        or isinstance(value, (bool, int, float, str))
        and not isinstance(value, np.generic)
    ):
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        if array.dtype.hasobject:
            raise TypeError(f"a state has an array of {array.dtype}, which cannot be saved")
        name = f"a{len(arrays)}"
        arrays[name] = array
        return {"array" if isinstance(value, np.ndarray) else "number": name}
    if type(value) in names:
        fields = [_encode(item, arrays, names) for item in _values(value)]
        return {"record": names[type(value)], "fields": fields}
    if isinstance(value, Mapping):
        return {
            "dict": [
                [_encode(key, arrays, names), _encode(item, arrays, names)]
                for key, item in value.items()
            ]
        }
    if type(value) in (tuple, list):
        kind = "tuple" if isinstance(value, tuple) else "list"
        return {kind: [_encode(item, arrays, names) for item in value]}
    raise TypeError(f"a state has a {type(value).__name__}, which cannot be saved")


def layout_of(types: Mapping[str, type]) -> dict[str, list[str]]:
    """Names of the fields of each type: values are read back by their place."""
    return {
        name: [field.name for field in dataclasses.fields(kind)]
        if dataclasses.is_dataclass(kind)
        else list(kind._fields)  # type: ignore[attr-defined]
        for name, kind in types.items()
    }


def _values(record: Any) -> list[Any]:
    if dataclasses.is_dataclass(record):
        return [getattr(record, field.name) for field in dataclasses.fields(record)]
    return list(record)


def _decode(tree: Any, arrays: Mapping[str, np.ndarray], types: Mapping[str, type]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "number" in tree:
        return arrays[tree["number"]][()]
    if "record" in tree:
        kind = types[tree["record"]]
        record = kind(*(_decode(item, arrays, types) for item in tree["fields"]))
        for (name, declared), value in zip(_declared(kind).items(), _values(record), strict=True):
            if not _is_of(value, declared, types):
                raise ValueError(f"{name} of {tree['record']} is of another type")
        return record
    if "dict" in tree:
        return {
            _decode(key, arrays, types): _decode(item, arrays, types) for key, item in tree["dict"]
        }
    items = [_decode(item, arrays, types) for item in tree["tuple" if "tuple" in tree else "list"]]
    return tuple(items) if "tuple" in tree else items


@cache
def _declared(kind: type) -> dict[str, Any]:
    """The types of a record's fields."""
    return get_type_hints(kind)


def _is_of(value: Any, declared: Any, types: Mapping[str, type]) -> bool:
    """Test if a value is of the type that a field declares. Types that nobody named are left to the caller."""
    if declared in _PLAIN:
        return isinstance(value, _PLAIN[declared])
    origin, inner = get_origin(declared), get_args(declared)
    if origin in (Union, kinds.UnionType):
        return any(_is_of(value, kind, types) for kind in inner)
    if origin is Literal:
        return value in inner
    if origin is tuple and inner[-1] is not Ellipsis:
        fits = isinstance(value, tuple) and len(value) == len(inner)
        return fits and all(
            _is_of(item, kind, types) for item, kind in zip(value, inner, strict=True)
        )
    if origin in (tuple, list):
        return isinstance(value, origin) and all(_is_of(item, inner[0], types) for item in value)
    if origin is dict:
        return isinstance(value, dict) and all(
            _is_of(key, inner[0], types) and _is_of(item, inner[1], types)
            for key, item in value.items()
        )
    if np.ndarray in (declared, origin):
        kind = get_args(inner[1])[0] if inner else Any  # of NDArray[kind]
        return (
            isinstance(value, np.ndarray)
            and value.ndim > 0
            and (kind is Any or value.dtype == kind)
        )
    return isinstance(value, declared) if declared in types.values() else True
