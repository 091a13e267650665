"""Chunks of a Zarr that are cut, lengthened, emptied or taken away, for every codec: refused, or read as they were."""

import json
import re
import shutil
import warnings
from pathlib import Path

import numcodecs
import numpy as np
import pytest
import zarr
from numcodecs import blosc
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec, GzipCodec, ShardingCodec, ZstdCodec
from zarr.codecs import numcodecs as codecs3

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.formats import zarr_files
from tests.io.formats.test_ome_zarr import make_store

SHAPE, CHUNK = (6, 5, 8), (6, 5, 4)
SHUFFLES = ("noshuffle", "shuffle", "bitshuffle")
NOISE = np.random.default_rng(7)


def image(dtype: str = "i2", level: int = 300) -> np.ndarray:
    """Values that pack a little, never 0."""
    smooth = np.add.outer(
        np.arange(SHAPE[0]), np.add.outer(np.arange(SHAPE[1]), np.arange(SHAPE[2]))
    )
    return (1 + smooth + NOISE.integers(0, level, SHAPE)).astype(dtype)


def packings() -> list:
    """What `zarr.Group.create_array` is given, for each codec that is read and both versions."""
    made = []
    for name in blosc.list_compressors():
        for number, shuffle in enumerate(SHUFFLES):
            made.append(
                (f"2 {name} {shuffle}", 2, {"compressors": numcodecs.Blosc(name, 5, number)})
            )
            codec = BloscCodec(cname=name, shuffle=shuffle, typesize=2)
            made.append((f"3 {name} {shuffle}", 3, {"compressors": codec}))
    made.append(("2 blosc not packed", 2, {"compressors": numcodecs.Blosc("lz4", 0)}))
    for codec in (
        numcodecs.Zstd(),
        numcodecs.Zstd(3, checksum=True),
        numcodecs.GZip(),
        numcodecs.Zlib(),
        numcodecs.LZ4(),
        numcodecs.LZMA(),
        numcodecs.BZ2(),
        None,
    ):
        made.append((f"2 {codec}", 2, {"compressors": codec}))
    for codec in (
        ZstdCodec(checksum=True),
        ZstdCodec(),
        GzipCodec(),
        Crc32cCodec(),
        codecs3.Zlib(),
        None,
    ):
        made.append((f"3 {codec}", 3, {"compressors": codec}))
    shuffled = {"filters": numcodecs.Shuffle(2), "compressors": numcodecs.Zstd()}
    made.append(("2 shuffle zstd", 2, shuffled))
    made.append(("3 zstd crc32c", 3, {"compressors": [ZstdCodec(), Crc32cCodec()]}))
    made.append(("3 big", 3, {"compressors": None, "serializer": BytesCodec(endian="big")}))
    turned = zarr.codecs.TransposeCodec(order=(2, 0, 1))
    made.append(("3 transposed", 3, {"filters": turned, "compressors": GzipCodec()}))
    made.append(("2 columns", 2, {"order": "F", "compressors": numcodecs.Blosc("zstd", 5)}))
    return [pytest.param(version, options, id=name) for name, version, options in made]


with warnings.catch_warnings(
    action="ignore"
):  # zarr says that codecs of numcodecs are not in Zarr 3
    PACKINGS = packings()


def sharded(index_codecs, location, codecs) -> dict:
    shards = ShardingCodec(
        chunk_shape=(3, 5, 2), codecs=codecs, index_codecs=index_codecs, index_location=location
    )
    return {"serializer": shards, "compressors": None}


SHARDS = [
    pytest.param(3, sharded(index, location, inner), id=f"{number} {location} {len(index)}")
    for location in ("start", "end")
    for index in ([BytesCodec()], [BytesCodec(), Crc32cCodec()])
    for number, inner in enumerate(
        [
            [BytesCodec()],
            [BytesCodec(), ZstdCodec()],
            [BytesCodec(), BloscCodec(cname="lz4", typesize=2)],
            [BytesCodec(), GzipCodec()],
        ]
    )
]


def store(path: Path, array: np.ndarray, version: int, options: dict) -> Path:
    """An OME-Zarr with an array packed in some way."""
    make_store(
        path, [], "zyx", [((2.0, 1.0, 1.0),)], "0.5" if version == 3 else "0.4", unit="millimeter"
    )
    group = zarr.open_group(path, mode="a")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        group.create_array("0", shape=array.shape, chunks=CHUNK, dtype=array.dtype, **options)[
            :
        ] = array
    return path


def chunk_file(path: Path, at: int = 0) -> Path:
    """The file of the chunk at a place along x."""
    return next(file for file in (path / f"0/c/0/0/{at}", path / f"0/0.0.{at}") if file.is_file())


def variations(raw: bytes) -> list[bytes]:
    """Cuts near both ends and some between, and tails of zeros, of noise, and of the bytes themselves."""
    tails = [
        b"\0",
        b"\0" * 8,
        b"\0" * 4096,
        NOISE.bytes(1),
        NOISE.bytes(16),
        NOISE.bytes(300),
        raw,
        raw[:20],
    ]
    n = len(raw)
    sizes = {*range(min(n, 18)), *range(max(0, n - 12), n), *NOISE.integers(0, n, 20).tolist()}
    return [raw[:size] for size in sorted(sizes)] + [raw + tail for tail in tails]


@pytest.mark.sampled(20)
@pytest.mark.parametrize(("version", "options"), PACKINGS + SHARDS)
def test_no_cut_or_lengthened_chunk_gives_other_values(tmp_path, version, options):
    array = image()
    path = store(tmp_path / "a.zarr", array, version, options)
    np.testing.assert_array_equal(io.read(path).array, array)
    lazy, box = io.open_volume(path, cache_bytes=0), whole_box(SHAPE)
    np.testing.assert_array_equal(lazy.read(box), array)
    file = chunk_file(path)
    raw = file.read_bytes()
    read = []
    for changed in variations(raw):
        file.write_bytes(changed)
        try:
            found = lazy.read(box)
        except InputError as error:
            assert (
                re.search(r"chunk \(\d, 0, \d\) of the array 0 is damaged", error.message)
                and error.hint
            )
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
        else:
            np.testing.assert_array_equal(found, array)
            read.append(len(changed) - len(raw))
    # A chunk that is read although it was changed has something behind its values, which no codec reads.
    assert not read or min(read) > 0, read


@pytest.mark.parametrize("cut", [1, 2, 3, 4, 5, 700])
def test_a_cut_chunk_is_refused_in_labels_and_in_the_whole(tmp_path, cut):
    image_path = store(
        tmp_path / "a.zarr", image(), 3, {"compressors": BloscCodec(cname="lz4", typesize=2)}
    )
    (image_path / "labels").mkdir()
    labels = store(
        image_path / "labels/cells",
        image("u2", 3),
        3,
        {"compressors": BloscCodec(clevel=0, typesize=2)},
    )
    for path, read in ((image_path, io.read), (labels, io.read_labels)):
        read(path)
        file = chunk_file(path, 1)
        file.write_bytes(file.read_bytes()[:-cut])
        with pytest.raises(InputError, match=r"chunk \(0, 0, 1\) of the array 0 is damaged"):
            read(path)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(12))
def test_chunks_are_those_that_zarr_reads(tmp_path, seed):
    """Orders of axes, types, byte orders, places in chunks of channels and at edges."""
    rng = np.random.default_rng(seed)
    names = "".join(rng.permutation(list("tczyx"[rng.integers(0, 3) :])))
    shape = tuple(int(n) for n in rng.integers(1, 9, len(names)))
    chunks = tuple(int(rng.integers(1, n + 3)) for n in shape)
    version, dtype = (
        int(rng.integers(2, 4)),
        str(rng.choice(["u1", "<i2", ">i2", "<f4", ">f8", "<u4", "bool"])),
    )
    array = (rng.integers(0, 99, shape) if dtype != "bool" else rng.integers(0, 2, shape)).astype(
        dtype
    )
    more: dict = {"multiscale": {}, "unit": "millimeter"}
    path = make_store(
        tmp_path / "a.zarr",
        [array],
        names,
        [((1.0,) * len(shape),)],
        "0.5" if version == 3 else "0.4",
        chunks=chunks,
        **more,
    )
    place = {
        name: int(rng.integers(0, n)) for name, n in zip(names, shape, strict=True) if name in "tc"
    }
    lazy = io.open_volume(path, time_index=place.get("t"), channel_index=place.get("c"))
    rest = [name for name in names if name in "zyx"]
    expected = array[tuple(place.get(name, slice(None)) for name in names)]
    expected = expected.transpose([rest.index(name) for name in "zyx"])
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), expected)


def test_a_chunk_that_unpacks_to_more_is_refused(tmp_path):
    array = np.ones(SHAPE, np.uint8)
    bomb = bytes(1 << 22)
    for name, codec in (
        ("gzip", numcodecs.GZip()),
        ("zlib", numcodecs.Zlib()),
        ("zstd", numcodecs.Zstd()),
        ("blosc", numcodecs.Blosc()),
    ):
        path = store(tmp_path / f"{name}.zarr", array, 2, {"compressors": codec})
        chunk_file(path).write_bytes(codec.encode(bomb))
        with pytest.raises(InputError, match="is damaged"):
            io.read(path)


def test_codecs_that_are_not_known_are_refused_by_name(tmp_path):
    """Pickle runs the code that a chunk holds."""
    for role, codec in (
        ("filters", numcodecs.Base64()),
        ("filters", numcodecs.Delta("u1")),
        ("compressor", numcodecs.Pickle()),
    ):
        path = store(tmp_path / f"{codec.codec_id}.zarr", np.ones(SHAPE, "u1"), 2, {})
        said = json.loads((path / "0/.zarray").read_text())
        said[role] = [codec.get_config()] if role == "filters" else codec.get_config()
        (path / "0/.zarray").write_text(json.dumps(said))
        with pytest.raises(
            InputError, match=rf"packed with the codec {codec.codec_id} given, one of|pickle"
        ) as caught:
            io.open_volume(path)
        assert caught.value.hint


# ------------------------------------------------------------------------------------------------------ missing chunks


@pytest.mark.parametrize("separator", ["/", "."])
@pytest.mark.parametrize("version", ["0.4", "0.5"])
@pytest.mark.parametrize("fill", [0, 7])
def test_missing_chunks_are_counted_in_a_warning(tmp_path, version, separator, fill):
    array = np.random.default_rng(1).integers(8, 99, (2, 9, 9, 9)).astype("u1")
    path = make_store(tmp_path / "a.zarr", [], "czyx", [((1.0,) * 4,)], version, unit="millimeter")
    group = zarr.open_group(path, mode="a")
    keys = {"name": "v2" if version == "0.4" else "default", "separator": separator}
    group.create_array(
        "0",
        shape=array.shape,
        chunks=(1, 3, 3, 3),
        dtype="u1",
        fill_value=fill,
        chunk_key_encoding=keys,
    )[:] = array
    for channel in (0, 1):
        assert io.WARNING_KEY not in io.open_volume(path, channel_index=channel).metadata
    for place in ((1, 0, 1, 2), (1, 2, 2, 2), (0, 1, 1, 1)):
        key = separator.join(map(str, place))
        (path / "0" / (key if version == "0.4" else f"c{separator}{key}")).unlink()
        box = (place[0], *(slice(3 * n, 3 * n + 3) for n in place[1:]))
        array[box] = fill
    (path / "0" / "notes.txt").write_text("7.7.7.7")
    for channel, absent in ((0, 1), (1, 2)):
        lazy = io.open_volume(path, channel_index=channel)
        words = f"{absent} of 27 chunks of the array 0 are not in the store, and {fill} stands there: programs leave"
        assert (
            words in lazy.metadata[io.WARNING_KEY]
            and "copy the store again" in lazy.metadata[io.WARNING_KEY]
        )
        np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array[channel])
    both = io.channels.read_channels(path)
    assert [words[0] for words in (one.metadata[io.WARNING_KEY] for one in both)] == ["1", "2"]


def test_missing_chunks_of_a_sequence_are_counted_over_all_frames(tmp_path):
    array = np.random.default_rng(1).integers(8, 99, (3, 4, 4, 4)).astype("u1")
    path = make_store(
        tmp_path / "a.zarr",
        [array],
        "tzyx",
        [((1.0,) * 4,)],
        unit="millimeter",
        chunks=(1, 2, 4, 4),
    )
    assert io.read_sequence(path).notes == ()
    for place in ("0/0", "2/1"):
        (path / f"0/c/{place}/0/0").unlink()
    notes = io.read_sequence(path).notes
    words = "2 of 6 chunks of the array 0 are not in the store, and 0 stands there"
    assert len(notes) == 1 and notes[0].startswith(words)


def test_a_sequence_that_accelsurf_wrote_misses_its_chunks(tmp_path):
    array = np.zeros((3, 4, 5, 6), np.uint8)
    array[1, 2, 3] = 7  # the other frames are left out
    path = tmp_path / "a.ome.zarr"
    grid = Geometry((4, 5, 6), (1.0, 1.0, 1.0))
    with io.SequenceWriter(path, grid, (0.0, 1.0, 2.0), "s", np.uint8) as writer:
        for number, frame in enumerate(array):
            writer.write(number, frame)
    found = io.read_sequence(path)
    assert found.notes == () and [int(found.frame(n).array.max()) for n in range(3)] == [0, 7, 0]
    (path / "0/c/1/0/0/0").unlink()
    with pytest.raises(
        InputError, match=r"chunk \(1, 0, 0, 0\) of the array 0 is missing: it was there"
    ):
        io.read_sequence(path).frame(1)


def test_files_are_listed_once_however_often_the_image_is_opened_again(tmp_path, monkeypatch):
    import pickle

    path = make_store(
        tmp_path / "a.zarr", [image("u1"), image("u1")], "zyx", [((1.0,) * 3,), ((2.0,) * 3,)]
    )
    calls = []
    listed = zarr_files.ChunkFiles.places
    monkeypatch.setattr(
        zarr_files.ChunkFiles,
        "places",
        lambda self, wanted: calls.append(1) or listed(self, wanted),
    )
    lazy = io.open_volume(path)
    assert not calls  # nobody has asked yet
    (path / "0/c/0/0/0").unlink()
    for _ in range(3):
        assert "1 of 12 chunks" in lazy.metadata[io.WARNING_KEY]
    for again in (pickle.loads(pickle.dumps(lazy)), lazy.coarser()):
        again.read(whole_box(SHAPE))
        assert io.WARNING_KEY not in again.metadata
    assert len(calls) == 1
    assert "1 of 12 chunks" in io.read(path).metadata[io.WARNING_KEY]  # what was met is counted
    assert len(calls) == 1


def test_a_folder_that_cannot_be_read_is_an_error_with_the_name_of_the_image(tmp_path):
    path = make_store(tmp_path / "a.zarr", [image("u1")], "zyx", [((1.0,) * 3,)])
    lazy = io.open_volume(path)
    shutil.rmtree(path / "0/c/0")
    (path / "0/c/0").write_text("a file")
    assert "6 of 12 chunks" in lazy.metadata[io.WARNING_KEY]
    with pytest.raises(InputError, match=r"a\.zarr: cannot be read \(Not a directory"):
        lazy.read(whole_box(lazy.shape))


def test_a_shard_says_by_itself_what_was_left_out(tmp_path):
    array = image("u1", 9)
    array[:3, :, :2] = 0
    path = store(
        tmp_path / "a.zarr", array, 3, sharded([BytesCodec(), Crc32cCodec()], "end", [BytesCodec()])
    )
    whole = io.read(path)
    np.testing.assert_array_equal(whole.array, array)
    assert io.WARNING_KEY not in whole.metadata
    chunk_file(path, 1).unlink()
    assert "1 of 2 chunks" in io.read(path).metadata[io.WARNING_KEY]


@pytest.mark.parametrize("seed", range(4))
def test_a_chunk_that_accelsurf_wrote_is_missed_and_one_that_it_left_out_is_not(tmp_path, seed):
    rng = np.random.default_rng(seed)
    array = np.zeros((130, 70, 70), np.uint16)
    for corner in rng.integers(0, (130, 70, 70), (3, 3)):
        array[tuple(slice(c, c + 3) for c in corner)] = 5
    path = tmp_path / "a.ome.zarr"
    if seed % 2:
        io.write_labels(Volume.from_array(array), path)
    else:
        with io.LabelStore(path, Geometry(array.shape, (1.0, 1.0, 1.0)), np.uint16) as written:
            written.write(whole_box(array.shape), array)
    for level in (0, 1, 2):
        assert io.WARNING_KEY not in io.open_volume(path, level=level).metadata
    back = io.read(path)
    np.testing.assert_array_equal(back.array, array)
    assert io.WARNING_KEY not in back.metadata
    files = sorted((path / "0" / "c").rglob("*"))
    file = rng.choice([file for file in files if file.is_file()])
    file.unlink()
    where = ", ".join(file.relative_to(path / "0" / "c").parts)
    for read in (io.read, lambda path: io.open_volume(path).read(whole_box(array.shape))):
        with pytest.raises(
            InputError, match=rf"chunk \({where}\) of the array 0 is missing"
        ) as caught:
            read(path)
        assert '"stored" of "accelsurf"' in caught.value.hint
