"""States as bytes: nested tuples, dictionaries and named records of numbers and arrays, exact to the last bit.

Nothing that is read can run code: only types that the caller names are made, and arrays hold no objects.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from accelsurf.errors import InputError

#: Version of the format; raised when it changes, or the fields of a record or the state of a flow do.
FORMAT = 2
_TREE = "tree"


def to_bytes(value: Any, types: Mapping[str, type]) -> bytes:
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
    tree = json.dumps({"format": FORMAT, "records": _layout(types), "state": _encode(value, arrays, names)})
    stream = io.BytesIO()
    np.savez(stream, **{_TREE: np.frombuffer(tree.encode(), np.uint8)}, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def from_bytes(content: bytes, types: Mapping[str, type]) -> Any:
    """Return the state that `to_bytes` wrote.

    Raises
    ------
    InputError
        When the content is damaged, or of another format.
    """
    try:
        _check_members(content)
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            tree = json.loads(arrays[_TREE].tobytes().decode())
            if tree["format"] != FORMAT:
                raise InputError(
                    f"a checkpoint of format {tree['format']} was given, expected {FORMAT}", "run from the start again"
                )
            if tree["records"] != _layout(types):
                raise InputError("a checkpoint of another version of accelsurf was given", "run from the start again")
            return _decode(tree["state"], lambda name: arrays[name], types)
    except InputError:
        raise
    except Exception as error:  # whatever numpy and zipfile make of damaged bytes
        raise InputError(f"the checkpoint is damaged ({error})", "run from the start again") from None


def _check_members(content: bytes) -> None:
    """Refuse packed arrays, which `to_bytes` never writes: a few bytes of them could fill the memory."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
    packed = any(one.compress_type != zipfile.ZIP_STORED for one in members)
    if packed or sum(one.file_size for one in members) > len(content):
        raise ValueError("its arrays are packed, or longer than the file")


def _encode(value: Any, arrays: dict[str, np.ndarray], names: Mapping[type, str]) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)) and not isinstance(value, np.generic):
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
        return {"dict": [[_encode(key, arrays, names), _encode(item, arrays, names)] for key, item in value.items()]}
    if type(value) in (tuple, list):
        kind = "tuple" if isinstance(value, tuple) else "list"
        return {kind: [_encode(item, arrays, names) for item in value]}
    raise TypeError(f"a state has a {type(value).__name__}, which cannot be saved")


def _layout(types: Mapping[str, type]) -> dict[str, list[str]]:
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


def _decode(tree: Any, array: Callable[[str], np.ndarray], types: Mapping[str, type]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return array(tree["array"])
    if "number" in tree:
        return array(tree["number"])[()]
    if "record" in tree:
        return types[tree["record"]](*(_decode(item, array, types) for item in tree["fields"]))
    if "dict" in tree:
        return {_decode(key, array, types): _decode(item, array, types) for key, item in tree["dict"]}
    items = [_decode(item, array, types) for item in tree["tuple" if "tuple" in tree else "list"]]
    return tuple(items) if "tuple" in tree else items
