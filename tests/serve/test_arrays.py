"""Packed arrays: as the client packs them, and as nobody should."""

import struct

import numpy as np
import pytest

from accelsurf.errors import InputError

arrays = pytest.importorskip("accelsurf.serve.arrays", reason="the extra serve is not installed")
MOST = 1 << 20


@pytest.mark.parametrize("dtype", sorted(arrays.TYPES))
@pytest.mark.parametrize("shape", [(1,), (31,), (3, 5, 7), (1, 9, 1, 40)])
def test_arrays_are_exchanged_with_the_client(dtype, shape):
    client = pytest.importorskip("nnInteractive.inference.remote.serialization")
    for values in (np.zeros(shape), np.random.default_rng(0).random(shape) * 9):
        array = values.astype(dtype)
        assert np.array_equal(arrays.unpack(client.pack_array(array), MOST), array)
        assert np.array_equal(client.unpack_array(arrays.pack(array)), array)


def packed(shape=(4, 5, 6)):
    return bytearray(arrays.pack(np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)))


def changed(first, content):
    body = packed()
    body[first : first + len(content)] = content
    return body


#: Where the shape of `packed` begins, the number of its chunks, the sizes of the first, and its frame.
SHAPE, CHUNKS = 13, 13 + 24
SIZES, FRAME = CHUNKS + 4, CHUNKS + 20


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"NNIA",
        packed()[:20],
        packed()[:-1],
        packed() + b"0",
        changed(0, b"XXXX"),
        changed(4, b"\2"),
        changed(5, b"\3"),
        changed(6, b"\0"),
        changed(6, b"\377"),
        changed(8, b"U"),
        changed(SHAPE, struct.pack("<q", -4)),
        changed(SHAPE, struct.pack("<q", 0)),
        changed(SHAPE, struct.pack("<q", 3)),
        changed(SHAPE, struct.pack("<q", 5)),
        changed(CHUNKS, struct.pack("<I", 0)),
        changed(CHUNKS, struct.pack("<I", 2)),
        changed(CHUNKS, struct.pack("<I", (1 << 32) - 1)),
        changed(SIZES, struct.pack("<Q", 1 << 63)),
        changed(SIZES + 8, struct.pack("<Q", 1 << 63)),
        changed(FRAME + 4, struct.pack("<I", 1 << 31)),
        changed(FRAME + 8, struct.pack("<I", 1 << 31)),
        changed(FRAME + 8, struct.pack("<I", 0)),
        changed(FRAME + 12, struct.pack("<I", 1 << 31)),
    ],
)
def test_damaged_arrays_are_refused(body):
    with pytest.raises(InputError):
        arrays.unpack(body, MOST)


def test_what_a_header_claims_is_not_allocated():
    claimed = changed(SHAPE, struct.pack("<3q", 1 << 20, 1 << 20, 1 << 20))
    with pytest.raises(arrays.TooLargeError, match=f"{1 << 60} bytes, at most {MOST}"):
        arrays.unpack(claimed, MOST)
    with pytest.raises(
        InputError, match="do not fit"
    ):  # nor where it may be as large, as the chunks are short
        arrays.unpack(claimed, 1 << 61)
