"""Images in several files: NIfTI pairs by either of them, and MetaImages with a list of files."""

import gzip
import itertools
import random

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.errors import InputError

KINDS = {
    1: (nibabel.Nifti1Pair, nibabel.Nifti1Image),
    2: (nibabel.Nifti2Pair, nibabel.Nifti2Image),
}


def affine_of(draw):
    turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * draw.uniform(0.5, 2.0, 3), draw.normal(size=3) * 20
    return affine


def write_pair(folder, draw, version, header_packed, voxels_packed, upper):
    """A pair and the same image in one file."""
    shape = tuple(int(n) for n in draw.integers(2, 7, 3))
    dtype = draw.choice(["uint8", "int16", "float32", "int32"])
    array, affine = draw.integers(0, 200, shape).astype(dtype), affine_of(draw)
    pair, single = (kind(array, affine) for kind in KINDS[version])
    for image in (pair, single):
        image.header.set_xyzt_units("mm")
        if draw.random() < 0.5 and image is pair:
            image.header["vox_offset"] = 0
    nibabel.save(pair, folder / "a.hdr")
    nibabel.save(single, folder / "one.nii")
    for suffix, is_packed in ((".hdr", header_packed), (".img", voxels_packed)):
        path = folder / f"a{suffix}"
        content, name = path.read_bytes(), f"a{suffix.upper() if upper else suffix}"
        path.unlink()
        (folder / (name + ".gz" * is_packed)).write_bytes(
            gzip.compress(content) if is_packed else content
        )


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    ("header_packed", "voxels_packed"), list(itertools.product([False, True], repeat=2))
)
@pytest.mark.parametrize("seed", range(2))
def test_a_pair_is_the_same_image_as_one_file(
    version, header_packed, voxels_packed, seed, tmp_path
):
    draw = np.random.default_rng(seed + 10 * version)
    upper = seed == 1 and not (header_packed or voxels_packed)
    write_pair(tmp_path, draw, version, header_packed, voxels_packed, upper)
    expected = io.read(tmp_path / "one.nii")
    given = sorted(tmp_path.glob("[aA].*"))
    assert len(given) == 2
    for path in given:
        found = io.read(path)
        assert (
            np.array_equal(found.array, expected.array)
            and found.array.dtype == expected.array.dtype
        )
        assert found.geometry.matches(expected.geometry)


def test_what_is_no_pair_is_refused_by_name(tmp_path):
    draw = np.random.default_rng(3)
    write_pair(tmp_path, draw, 1, False, False, False)
    header, voxels = (tmp_path / "a.hdr").read_bytes(), (tmp_path / "a.img").read_bytes()
    cases = {
        "the file a.img, which is missing": (header, None),
        "Analyze 7.5": (header[:344] + bytes(4), voxels),
        "follow it in the same file": (header[:344] + b"n+1\0", voxels),
        "bytes of voxels, the file holds": (header, voxels[:-1]),
        "a NIfTI header alone has 348": (header[:300], voxels),
        "a.img is compressed, against": (header, gzip.compress(voxels)),
        "lacks the NIfTI marks": (bytes(352), voxels),
    }
    for number, (words, (about, content)) in enumerate(cases.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "a.hdr").write_bytes(about)
        if content is not None:
            (folder / "a.img").write_bytes(content)
        with pytest.raises(InputError, match=words):
            io.read(folder / "a.hdr")
    (tmp_path / "b.nii").write_bytes(header)
    with pytest.raises(InputError, match="in another file"):
        io.read(tmp_path / "b.nii")
    (tmp_path / "lonely.img").write_bytes(voxels)
    with pytest.raises(InputError, match="unknown file type"):
        io.read(tmp_path / "lonely.img")


def test_a_pair_is_segmented_and_neither_file_is_replaced(tmp_path, monkeypatch, capfd):
    z, y, x = np.indices((10, 11, 12)) - 5
    array = (100 * (z * z + y * y + x * x < 9)).astype(np.uint8)
    nibabel.save(nibabel.Nifti1Pair(array.T, np.eye(4)), tmp_path / "a.hdr")
    before = [(tmp_path / f"a.{end}").read_bytes() for end in ("hdr", "img")]
    monkeypatch.chdir(tmp_path)
    words = ("--start", "ball:-5,-5,5,2", "--max-steps", "2", "--progress", "none", "--overwrite")
    for name in ("a.hdr", "a.img"):
        assert execute(["segment", name, "-o", ".", *words]) == 0
    assert execute(["look", "a.hdr", "-o", "a.img.png"]) == 0
    assert before == [(tmp_path / f"a.{end}").read_bytes() for end in ("hdr", "img")]
    assert execute(["batch", ".", "-o", "out", *words, "--jobs", "1"]) in (0, 9)
    capfd.readouterr()


def listed(path, array, draw, dims=None, skip=0):
    """A MetaImage with a file for each slice (or part), as ITK reads it."""
    order = draw.choice(["True", "False"])
    raw = array.astype(array.dtype.newbyteorder(">" if order == "True" else "<"))
    parts = {3: [raw], 2: list(raw), 1: [row for plane in raw for row in plane]}[dims or 2]
    names = [f"part {number:03d}.raw" for number in range(len(parts))]
    for name, part in zip(names, parts, strict=True):
        (path.parent / name).write_bytes(
            b"h" * max(skip, 0) + (b"junk" if skip < 0 else b"") + part.tobytes()
        )
    met = {"uint8": "MET_UCHAR", "int16": "MET_SHORT", "float32": "MET_FLOAT"}[array.dtype.name]
    size = " ".join(map(str, array.shape[::-1]))
    path.write_text(
        f"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {order}\n"
        f"Offset = 3 4 -5\nElementSpacing = 0.5 0.75 2\nDimSize = {size}\nElementType = {met}\n"
        + (f"HeaderSize = {skip}\n" if skip else "")
        + f"ElementDataFile = LIST{f' {dims}D' if dims else ''}\n"
        + "\n".join(names)
        + draw.choice(["", "\n", "\n\n"])
    )
    return names


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("dims", [None, 1, 2, 3])
def test_a_list_of_files_is_one_volume(dims, seed, tmp_path):
    draw = random.Random(seed)
    dtype = draw.choice(["uint8", "int16", "float32"])
    array = np.random.default_rng(seed).integers(0, 200, (3, 4, 5)).astype(dtype)
    listed(tmp_path / "a.mhd", array, draw, dims, draw.choice([0, 7, -1]))
    found = io.read(tmp_path / "a.mhd")
    assert np.array_equal(found.array, array) and found.array.dtype == array.dtype
    assert found.geometry.spacing == (2.0, 0.75, 0.5) and found.geometry.origin == (3.0, 4.0, -5.0)


def test_a_list_is_read_as_by_itk(tmp_path):
    array = np.random.default_rng(1).integers(0, 200, (3, 4, 5)).astype(np.int16)
    listed(tmp_path / "a.mhd", array, random.Random(1))
    other = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "a.mhd")))
    assert np.array_equal(io.read(tmp_path / "a.mhd").array, other)


@pytest.mark.parametrize(
    "change", ["short", "missing", "one less", "one more", "elsewhere", "packed", "pipe"]
)
def test_a_list_that_is_not_whole_is_refused(change, tmp_path):
    import os

    folder = tmp_path / "in"
    folder.mkdir()
    array = np.random.default_rng(1).integers(0, 200, (3, 4, 5)).astype(np.int16)
    path, draw = folder / "a.mhd", random.Random(2)
    names = listed(path, array, draw)
    last, text = folder / names[-1], path.read_text().rstrip("\n")
    if change == "short":
        last.write_bytes(last.read_bytes()[:-1])
    elif change in ("missing", "pipe"):
        last.unlink()
        if change == "pipe":
            os.mkfifo(last)
    elif change == "one less":
        path.write_text(text.rpartition("\n")[0])
    elif change == "one more":
        path.write_text(text + "\n" + names[0])
    elif change == "elsewhere":
        (tmp_path / "secret").write_bytes(last.read_bytes())
        path.write_text(text.replace(names[-1], "../secret"))
    else:
        path.write_text(text.replace("BinaryData =", "CompressedData = True\nBinaryData ="))
    with pytest.raises(InputError, match=r"a\.mhd: "):
        io.read(path)
