"""Packed streams: read in few large pieces, and no further than is needed to know what is in them."""

import gzip
import io
import zlib

import numpy as np
import pytest

from accelsurf.errors import InputError
from accelsurf.io.formats import deflate
from accelsurf.settings import budgets

PLAIN = np.random.default_rng(0).integers(0, 64, 20_000_000, np.uint8).tobytes()
PACKED = zlib.compress(PLAIN, 1)


class Counting(io.BytesIO):
    """A file that notes how much of it was read at a time."""

    def __init__(self, content):
        super().__init__(content)
        self.sizes = []

    def read(self, size=-1):
        piece = super().read(size)
        self.sizes.append(len(piece))
        return piece


def test_a_large_stream_takes_few_turns():
    file = Counting(PACKED)
    pieces = list(deflate.inflate(file, None, len(PLAIN)))
    assert b"".join(pieces) == PLAIN
    # Each turn may wait for Python's lock: 64 KiB at a time would be 250 of them.
    assert len(file.sizes) < 20 and len(pieces) < 20
    assert max(map(len, pieces)) <= 1 << 23


def test_a_header_is_read_without_the_rest():
    file = Counting(gzip.compress(PLAIN, 1))
    assert deflate.first_bytes(file, 540) == PLAIN[:540]
    assert sum(file.sizes) <= 1 << 16


@pytest.mark.sampled(2)
@pytest.mark.parametrize("claimed", [0, 1000, 9_000_000])
def test_what_goes_on_beyond_its_announced_end_is_refused_soon(claimed):
    packed = zlib.compress(bytes(400_000_000), 6)
    unpacked = 0
    with pytest.raises(InputError, match=f"announces {claimed} bytes, the packed voxels go on"):
        for piece in deflate.inflate(io.BytesIO(packed), None, claimed):
            unpacked += len(piece)
    assert unpacked <= claimed + 2 * budgets.SLACK.limit


@pytest.mark.sampled(3)
@pytest.mark.parametrize("limit", [None, 3_000_000])
@pytest.mark.parametrize("cut", [1, 5, 100_000, 10_000_000])
def test_a_stream_that_is_cut_short_is_refused_at_any_size_of_pieces(cut, limit):
    with pytest.raises(InputError, match="end before their end mark"):
        list(deflate.inflate(io.BytesIO(gzip.compress(PLAIN, 1)[:-cut]), limit))


def test_several_members_are_one_stream_and_what_follows_them_is_ignored():
    parts = [PLAIN[:7], PLAIN[7:5_000_000], b"", PLAIN[5_000_000:]]
    packed = b"".join(gzip.compress(part, 1) for part in parts) + bytes(512)
    assert b"".join(deflate.inflate(io.BytesIO(packed), None, len(PLAIN))) == PLAIN


@pytest.mark.sampled(2)
@pytest.mark.parametrize("place", [-6, -300_000, 4_000_000])
def test_a_byte_that_is_wrong_is_damage(place):
    packed = bytearray(gzip.compress(PLAIN, 1))
    packed[place] ^= 0x55
    with pytest.raises(InputError, match="damaged|end mark"):
        list(deflate.inflate(io.BytesIO(bytes(packed)), None, len(PLAIN)))
