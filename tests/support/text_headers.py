"""Plain headers of NRRD and MetaImage, with changes, and how files that are no good are refused."""

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError

VALUES = np.random.default_rng(0).integers(0, 30000, (4, 5, 6)).astype(np.int16)


def refuse(path, words, family=InputError):
    with pytest.raises(family, match=words) as caught:
        io.read(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert caught.value.hint or "finite numbers" in words


def text_header(suffix, **changes):
    """Lines of a plain header; a change of None takes a line out."""
    lines = {
        ".nrrd": {
            "type": "short",
            "dimension": "3",
            "sizes": "6 5 4",
            "spacings": "1 2 3",
            "endian": "little",
            "encoding": "raw",
        },
        ".mha": {
            "ObjectType": "Image",
            "NDims": "3",
            "BinaryData": "True",
            "BinaryDataByteOrderMSB": "False",
            "ElementSpacing": "1 2 3",
            "DimSize": "6 5 4",
            "ElementType": "MET_SHORT",
        },
    }[suffix]
    lines.update({key.replace("_", " "): value for key, value in changes.items()})
    kept = [(k, v) for k, v in lines.items() if v is not None]
    if suffix == ".nrrd":
        return ("NRRD0004\n" + "".join(f"{k}: {v}\n" for k, v in kept) + "\n").encode()
    data = lines.get("ElementDataFile", "LOCAL")
    return (
        "".join(f"{k} = {v}\n" for k, v in kept if k != "ElementDataFile")
        + f"ElementDataFile = {data}\n"
    ).encode()
