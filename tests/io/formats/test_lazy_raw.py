"""NRRD and MetaImage whose voxels are stored as they are, read box by box."""

import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from tests.io.test_lazy_volume import assert_same_boxes, values

NRRD_TYPES = {
    "int16": "short",
    "uint8": "uchar",
    "float32": "float",
    "uint64": "uint64",
    "int32": "int",
    "int8": "int8",
}
META_TYPES = {
    **{
        "int16": "MET_SHORT",
        "uint8": "MET_UCHAR",
        "float32": "MET_FLOAT",
        "uint64": "MET_ULONG_LONG",
    },
    **{"int32": "MET_LONG", "int8": "MET_CHAR"},
}


def nrrd(dtype: str, order: str, more: str = "") -> bytes:
    head = (
        f"NRRD0004\ntype: {NRRD_TYPES[dtype]}\ndimension: 3\nspace: right-anterior-superior\nsizes: 9 7 5\n"
        f"space directions: (0,0.5,0) (0.25,0,0) (0,0,2)\nspace origin: (1,-2,3)\nencoding: raw\n{more}"
    )
    return (
        head + ("" if order == "|" else f"endian: {'big' if order == '>' else 'little'}\n")
    ).encode()


def metaimage(dtype: str, order: str, more: str = "", key: str = "BinaryDataByteOrderMSB") -> bytes:
    return (
        f"ObjectType = Image\nNDims = 3\nBinaryData = True\n{key} = {order == '>'}\n"
        f"TransformMatrix = 0 1 0 1 0 0 0 0 1\nOffset = 1 -2 3\nElementSpacing = 0.5 0.25 2\nDimSize = 9 7 5\n"
        f"{more}ElementType = {META_TYPES[dtype]}\n"
    ).encode()


@pytest.fixture(autouse=True)
def silence(capfd):
    yield
    assert capfd.readouterr() == ("", "")


@pytest.mark.sampled
@pytest.mark.parametrize("dtype", META_TYPES)
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("detached", [False, True])
def test_boxes_are_those_of_the_whole_image(tmp_path, dtype, order, detached):
    stored = values(dtype).astype(np.dtype(dtype).newbyteorder(order)).tobytes()
    (tmp_path / "voxels.raw").write_bytes(stored)
    rest = b"" if detached else stored
    data = b"data file: voxels.raw\n" if detached else b""
    (tmp_path / "a.nrrd").write_bytes(
        nrrd(dtype, order if np.dtype(dtype).itemsize > 1 else "|") + data + b"\n" + rest
    )
    where = b"ElementDataFile = voxels.raw\n" if detached else b"ElementDataFile = LOCAL\n"
    (tmp_path / "a.mha").write_bytes(metaimage(dtype, order) + where + rest)
    other = metaimage(dtype, order, key="ElementByteOrderMSB")
    (tmp_path / "b.mhd").write_bytes(other + where + rest)
    for name in ("a.nrrd", "a.mha", "b.mhd"):
        lazy = assert_same_boxes(tmp_path / name)
        np.testing.assert_array_equal(
            lazy.read(tuple(slice(0, n) for n in lazy.shape)), values(dtype)
        )


@pytest.mark.parametrize("skip", [-1, 0, 13, 400])
@pytest.mark.parametrize("detached", [False, True])
def test_bytes_before_the_voxels_are_skipped_as_by_others(tmp_path, skip, detached):
    """A byte skip of an NRRD counts from the end of its header, a HeaderSize from the start of the file."""
    stored, noise = values("int16").tobytes(), bytes(range(200)) * 2
    before = {-1: noise, 0: b"", 13: noise[:13], 400: noise}[skip]
    (tmp_path / "voxels.raw").write_bytes(before + stored)
    text = nrrd("int16", "<", f"byte skip: {skip}\n") + (
        b"data file: voxels.raw\n\n" if detached else b"\n"
    )
    (tmp_path / "a.nrrd").write_bytes(text if detached else text + before + stored)
    head = metaimage("int16", "<", f"HeaderSize = {skip}\n")
    head += b"ElementDataFile = voxels.raw\n" if detached else b"ElementDataFile = LOCAL\n"
    if not detached and skip == 400:
        head += b"#" * (400 - len(head))
    if detached or skip in (-1, 0, 400):
        (tmp_path / "a.mhd").write_bytes(
            head if detached else head + (stored if skip == 400 else before + stored)
        )
    for path in (path for path in (tmp_path / "a.nrrd", tmp_path / "a.mhd") if path.exists()):
        lazy = assert_same_boxes(path)
        np.testing.assert_array_equal(
            lazy.read(tuple(slice(0, n) for n in lazy.shape)), values("int16")
        )


@pytest.mark.parametrize("suffix", [".nrrd", ".mha", ".mhd"])
def test_packed_voxels_are_refused_with_what_to_do(tmp_path, suffix):
    io.write(Volume.from_array(values("i2")), tmp_path / f"a{suffix}")
    with pytest.raises(InputError, match=rf"a{suffix}: the voxels are packed") as caught:
        io.open_volume(tmp_path / f"a{suffix}")
    assert "OME-Zarr" in caught.value.hint and "uncompressed" in caught.value.hint


def test_lines_to_skip_are_refused(tmp_path):
    start = nrrd("int16", "<", "line skip: 1\n") + b"\none line\n"
    (tmp_path / "a.nrrd").write_bytes(start + values("int16").tobytes())
    with pytest.raises(InputError, match="lines to skip"):
        io.open_volume(tmp_path / "a.nrrd")


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_a_file_cut_short_and_other_sorts_of_images_are_refused(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    image = sitk.GetImageFromArray(values("f4"))
    sitk.WriteImage(image, str(path), useCompression=False)
    assert_same_boxes(path)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(InputError, match="announces 1260 bytes of voxels, the file holds 1253"):
        io.open_volume(path)
    sitk.WriteImage(sitk.Compose(image, image), str(path), useCompression=False)
    with pytest.raises(InputError, match="2 channels"):
        io.open_volume(path)


def test_a_header_may_not_name_data_elsewhere(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "voxels.raw").write_bytes(values("int16").tobytes())
    path = tmp_path / "here" / "a.mhd"
    path.write_bytes(metaimage("int16", "<") + b"ElementDataFile = ../voxels.raw\n")
    with pytest.raises(InputError, match="outside of its own folder"):
        io.open_volume(path)
