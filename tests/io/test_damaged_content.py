"""Damage that a library meets: one line of ours and exit 3, whatever it raises, and none of its own lines."""

import gzip
import io as streams
import lzma
import struct
import zipfile

import numpy as np
import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.errors import AccelsurfError, InputError
from accelsurf.image.volume import Volume
from accelsurf.io import label_tables
from accelsurf.io.files import library_named

ARRAY = np.random.default_rng(0).integers(0, 300, (5, 6, 7)).astype(np.int16)
KINDS = {
    "stored": zipfile.ZIP_STORED,
    "deflate": zipfile.ZIP_DEFLATED,
    "bzip2": zipfile.ZIP_BZIP2,
    "lzma": zipfile.ZIP_LZMA,
}


def mgh(code=4, values=ARRAY, good=0):
    head = struct.pack(">7ih", 1, *values.shape[::-1], 1, code, 0, good).ljust(284, b"\0")
    return head + values.astype(values.dtype.newbyteorder(">")).tobytes()


def archive(kind, name, content):
    stream = streams.BytesIO()
    with zipfile.ZipFile(stream, "w", kind) as out:
        out.writestr(name, content)
    return stream.getvalue()


def npy(array=ARRAY):
    stream = streams.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def valid():
    """Suffix -> the bytes of small valid files."""
    text = "NRRD0004\ntype: short\ndimension: 3\nsizes: 7 6 5\nendian: little\nencoding: gzip\n\n"
    meta = "NDims = 3\nDimSize = 7 6 5\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    yield from ((".mgh", mgh()), (".mgz", gzip.compress(mgh())), (".npy", npy()))
    yield from (
        (".nrrd", text.encode() + gzip.compress(ARRAY.tobytes())),
        (".mha", meta.encode() + ARRAY.tobytes()),
    )


@pytest.mark.parametrize("number", range(len(list(valid()))))
def test_flipped_and_cut_files_are_one_line(number, tmp_path, capfd):
    suffix, content = list(valid())[number]
    random = np.random.default_rng(number)
    path = tmp_path / f"a{suffix}"
    for turn in range(80):
        changed = bytearray(content)
        if turn % 4 == 0:
            del changed[int(random.integers(len(content))) :]
        elif turn % 4 == 1:
            at = int(random.integers(len(content)))
            changed[at : at + 16] = random.bytes(min(16, len(content) - at))
        else:
            changed[int(random.integers(len(content)))] ^= 1 << int(random.integers(8))
        path.write_bytes(changed)
        try:
            io.read(path)
        except AccelsurfError as error:
            assert (
                error.exit_code in (2, 3) and str(error).startswith(f"{path}: ") and error.hint
            ), str(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("code", [*range(-2, 30), 2**15, 2**31 - 1])
def test_types_of_mgh(code, tmp_path, capfd):
    known = {0: "u1", 1: "i4", 3: "f4", 4: "i2", 10: "u2"}
    path = tmp_path / "a.mgh"
    path.write_bytes(mgh(code, (ARRAY % 200).astype(known.get(code, "i2"))))
    if code in known:
        np.testing.assert_array_equal(io.read(path).array, ARRAY % 200)
        return
    with pytest.raises(InputError, match=f"an MGH of type {code} given"):
        io.read(path)
    assert execute(["look", str(path), "-o", str(tmp_path)]) == 3
    assert len(capfd.readouterr().err.splitlines()) == 2


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 1e30, -1e300])
def test_grids_of_mgh_that_are_none(value, tmp_path, capfd):
    for place in range(15):
        numbers = [1, 1, 1, -1, 0, 0, 0, 0, -1, 0, 1, 0, 5, 6, 7]
        numbers[place] = np.clip(value, -3e38, 3e38) if np.isfinite(value) else value
        content = bytearray(mgh(good=1))
        struct.pack_into(">15f", content, 30, *numbers)
        (tmp_path / "a.mgh").write_bytes(content)
        try:
            io.read(tmp_path / "a.mgh")
        except InputError as error:
            assert error.hint
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "error",
    [
        lzma.LZMAError("a"),
        zipfile.BadZipFile("a"),
        EOFError(),
        struct.error("a"),
        KeyError("a"),
        RecursionError(),
        UnicodeDecodeError("utf-8", b"a", 0, 1, "a"),
        OverflowError("a\nb"),
        NotImplementedError("a"),
        TypeError("a"),
        gzip.BadGzipFile("a"),
        AttributeError("a"),
        OSError("a"),
    ],
)
def test_what_libraries_raise_is_one_line(error):
    with (
        pytest.raises(InputError, match=r"^it is damaged \(") as caught,
        library_named("it is damaged", "copy it"),
    ):
        raise error
    assert "\n" not in str(caught.value) and caught.value.hint == "copy it"


@pytest.mark.parametrize("error", [PermissionError(13, "no"), MemoryError(), KeyboardInterrupt()])
def test_what_is_no_damage_passes(error):
    with pytest.raises(type(error)), library_named("it is damaged", "copy it"):
        raise error


@pytest.mark.parametrize(
    "suffix", [".csv", ".tsv", ".txt", ".ctbl", ".seg.nrrd", ".nii", ".nii.gz"]
)
def test_damaged_label_tables_are_one_line(suffix, tmp_path, capfd):
    random, path = np.random.default_rng(5), tmp_path / f"a{suffix}"
    io.write(Volume.from_array(ARRAY), tmp_path / "b.nii")
    texts = {
        ".csv": b"id,name,color,r\n1,a,#ff0000,2\n",
        ".tsv": b"index\tname\tr\tg\tb\n1\ta\t1\t2\t3\n",
        ".ctbl": b"1 a 1 2 3 4\n",
        ".txt": b'1 1 2 3 1 1 1 "a"\n',
        ".seg.nrrd": b"NRRD0004\nSegment0_Name:=a\nSegment0_Color:=1 0 0\n\n",
    }
    content = texts.get(suffix, (tmp_path / "b.nii").read_bytes())
    pieces = [
        b"\xc2\xb2",
        "\u0663".encode(),
        b"9" * 5000,
        b'"',
        b"\0",
        b"-1",
        b"1e999",
        b"nan",
        b"\n",
        b"a" * 200_000,
    ]
    for turn in range(120):
        changed = bytearray(content)
        at = int(random.integers(len(content)))
        changed[at : at + turn % 3] = pieces[turn % len(pieces)]
        path.write_bytes(gzip.compress(changed) if suffix.endswith(".gz") else changed)
        try:
            label_tables.read_label_table(path)
        except AccelsurfError as error:
            assert error.exit_code == 3 and len(str(error)) < 1000 and "\n" not in str(error)
    assert capfd.readouterr() == ("", "")
