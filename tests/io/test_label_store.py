"""Label maps that are written box by box: the same as if they were written at once, whole or not at all."""

import errno
import json
import os
from pathlib import Path

import nibabel
import numpy as np
import pytest
import yaozarrs

from accelsurf import io
from accelsurf.errors import OutputError, UsageError
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.formats import nifti_volumes, zarr_pyramid
from tests.support.folders import contents

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
GRID = Geometry((70, 75, 150), (2.0, 0.5, 0.25), (-12.5, 4.0, 100.25), TURN)
SUFFIXES = (".nii", ".ome.zarr")


def labels(shape=GRID.shape, top=700) -> np.ndarray:
    """Two boxes of labels in a grid of zeros."""
    array = np.zeros(shape, np.uint16)
    rng = np.random.default_rng(5)
    array[60:69, 3:20, 60:140] = rng.integers(0, top, (9, 17, 80))
    array[1:5, 70:75, 1:9] = 3
    return array


def fill(
    store: io.LabelStore, array: np.ndarray, step: tuple[int, int, int] = (32, 75, 40)
) -> None:
    """Write all boxes of a size, in an order of no meaning."""
    nz, ny, nx = array.shape
    corners = [
        (z, y, x)
        for z in range(0, nz, step[0])
        for y in range(0, ny, step[1])
        for x in range(0, nx, step[2])
    ]
    for i in np.random.default_rng(1).permutation(len(corners)):
        corner = corners[i]
        box = box_at(
            corner, [min(w, n - c) for w, n, c in zip(step, array.shape, corner, strict=True)]
        )
        if array[box].any():
            store.write(box, array[box])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_boxes_give_the_bytes_of_the_whole(tmp_path, suffix):
    array = labels()
    metadata = {}
    if suffix == ".nii":  # numbers and codes of a header that was read go back into it
        io.write(Volume(array, GRID), tmp_path / "scan.nii")
        with (tmp_path / "scan.nii").open("r+b") as file:
            file.seek(252)
            file.write(bytes([3, 0, 3, 0]))
        metadata = io.read(tmp_path / "scan.nii").metadata
        assert metadata
    io.write_labels(Volume(array, GRID, metadata), tmp_path / f"whole{suffix}")
    with io.LabelStore(tmp_path / f"boxes{suffix}", GRID, np.uint16, metadata) as store:
        fill(store, array)
        np.testing.assert_array_equal(
            store.read(box_at((60, 0, 50), (10, 30, 30))), array[60:70, 0:30, 50:80]
        )
        assert not (tmp_path / f"boxes{suffix}").exists()
    whole, boxes = tmp_path / f"whole{suffix}", tmp_path / f"boxes{suffix}"
    if suffix == ".nii":
        assert boxes.read_bytes() == whole.read_bytes()
    else:
        # The name of the image is in its metadata.
        named = {k: v.replace(b'"boxes"', b'"whole"') for k, v in contents(boxes).items()}
        assert named == contents(whole)
    back = io.read(boxes)
    np.testing.assert_array_equal(back.array, array, strict=True)
    assert back.geometry.difference(GRID) == ""


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_nothing_appears_when_the_work_fails(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    with io.LabelStore(path, GRID, np.uint8) as store:
        store.write(box_at((0, 0, 0), (2, 2, 2)), np.ones((2, 2, 2), np.uint8))
    before = contents(tmp_path)
    with pytest.raises(KeyboardInterrupt), io.LabelStore(path, GRID, np.uint8) as store:
        store.write(box_at((0, 0, 0), (2, 2, 2)), np.full((2, 2, 2), 2, np.uint8))
        raise KeyboardInterrupt
    assert contents(tmp_path) == before and sorted(os.listdir(tmp_path)) == [f"a{suffix}"]
    with io.LabelStore(path, GRID, np.uint8):
        pass  # all zeros, in place of the old one
    assert not io.read(path).array.any() and sorted(os.listdir(tmp_path)) == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("when", ["write", "finish"])
def test_a_full_disk_is_an_error_that_leaves_nothing(tmp_path, monkeypatch, suffix, when):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    owner = nifti_volumes.NiftiBoxes if suffix == ".nii" else zarr_pyramid.ZarrPyramid
    monkeypatch.setattr(owner, when, full)
    store = io.LabelStore(tmp_path / f"a{suffix}", GRID, np.uint8)
    with pytest.raises(
        OutputError, match=rf"a{suffix}: cannot be written \(No space left"
    ) as caught:
        store.write(box_at((0, 0, 0), (1, 1, 1)), np.ones((1, 1, 1), np.uint8))
        store.commit()
    assert "space" in caught.value.hint and os.listdir(tmp_path) == []


@pytest.mark.sampled(1)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_size_limit_is_an_error_of_the_system_itself(tmp_path, suffix):
    """As on a full disk: the system refuses the bytes, not a stand-in."""
    import subprocess
    import sys

    code = f"""
import resource, signal, numpy as np
from accelsurf import io
from accelsurf.errors import OutputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.boxes import box_at
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
try:
    with io.LabelStore({str(tmp_path / f"a{suffix}")!r}, Geometry((64, 64, 64), (1, 1, 1)), np.uint32) as store:
        noise = np.random.default_rng(0).integers(0, 2**32, (64, 64, 64), np.uint32)
        store.write(box_at((0, 0, 0), (64, 64, 64)), noise)
except OutputError as error:
    print(error, error.exit_code)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[2]
    )
    assert done.stdout == f"{tmp_path / f'a{suffix}'}: cannot be written (File too large) 7\n", (
        done.stderr
    )
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_folder_that_is_not_there_is_an_error(tmp_path, suffix):
    with pytest.raises(OutputError, match="cannot be written"):
        io.LabelStore(tmp_path / "none" / f"a{suffix}", GRID, np.uint8)


def test_a_folder_of_something_else_is_never_replaced(tmp_path):
    (tmp_path / "a.ome.zarr").mkdir()
    (tmp_path / "a.ome.zarr" / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match="is a folder"):
        io.LabelStore(tmp_path / "a.ome.zarr", GRID, np.uint8)
    assert contents(tmp_path) == {"a.ome.zarr/thesis.txt": b"years of work"}


def test_what_is_no_label_map_is_refused(tmp_path):
    with pytest.raises(UsageError, match="uint8, uint16 or uint32"):
        io.LabelStore(tmp_path / "a.nii", GRID, np.float32)
    with pytest.raises(UsageError, match=r"\.nii or \.ome\.zarr"):
        io.LabelStore(tmp_path / "a.nrrd", GRID, np.uint8)
    with io.LabelStore(tmp_path / "a.nii", GRID, np.uint8) as store:
        with pytest.raises(UsageError, match="within the grid"):
            store.write(box_at((69, 0, 0), (2, 1, 1)), np.ones((2, 1, 1), np.uint8))
        with pytest.raises(UsageError, match=r"\(1, 2, 1\) of uint8 given"):
            store.write(box_at((0, 0, 0), (2, 1, 1)), np.ones((1, 2, 1), np.uint8))


def test_a_long_axis_makes_a_nifti_of_version_2(tmp_path):
    grid = Geometry((1, 2, 40000), (2.0, 0.5, 0.25), (-12.5, 4.0, 100.25), TURN)
    with io.LabelStore(tmp_path / "a.nii", grid, np.uint32) as store:
        store.write(box_at((0, 1, 39999), (1, 1, 1)), np.full((1, 1, 1), 2**32 - 1, np.uint32))
    back = io.read(tmp_path / "a.nii")
    assert back.geometry.difference(grid) == "" and back.array.dtype == np.uint32
    assert np.argwhere(back.array).tolist() == [[0, 1, 39999]] and back.array.max() == 2**32 - 1
    other = nibabel.load(tmp_path / "a.nii")
    assert isinstance(other, nibabel.Nifti2Image) and other.shape == (40000, 2, 1)
    lps = np.diag([-1, -1, 1, 1]) @ other.affine @ [39999, 1, 0, 1]
    np.testing.assert_allclose(lps[:3], grid.index_to_world((0, 1, 39999)), atol=1e-9)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_more_than_2_to_the_32_voxels_take_little_space(tmp_path, suffix):
    n, path = 1701, tmp_path / f"a{suffix}"
    box = box_at((1695, 1690, 1699), (6, 11, 2))
    with io.LabelStore(path, Geometry((n, n, n), (0.5, 0.5, 0.5)), np.uint8) as store:
        store.write(box, np.full((6, 11, 2), 9, np.uint8))
    lazy = io.open_volume(path)
    assert lazy.shape == (n, n, n)
    wide = lazy.read(box_at((1690, 1680, 1690), (11, 21, 11)))
    assert (wide[5:, 10:, 9:] == 9).all() and wide.sum() == 9 * 6 * 11 * 2
    assert sum(f.stat().st_blocks * 512 for f in tmp_path.rglob("*")) < 1 << 20
    if suffix == ".ome.zarr":
        last = (
            len(
                json.loads((path / "zarr.json").read_text())["attributes"]["ome"]["multiscales"][0][
                    "datasets"
                ]
            )
            - 1
        )
        coarse = io.open_volume(path, level=last)
        assert max(coarse.shape) <= 64 and (coarse.read(whole_box(coarse.shape)) > 0).sum() <= 1


def test_the_levels_of_labels_are_labels_where_they_lie(tmp_path):
    """A voxel of each level has the label of the finest level at its own centre, and the store is OME-Zarr."""
    array = labels()
    io.write(Volume(array, GRID), tmp_path / "scan.ome.zarr")
    path = tmp_path / "a.ome.zarr"
    with io.LabelStore(path, GRID, np.uint16, source=tmp_path / "scan.ome.zarr") as store:
        fill(store, array)
    finest = io.open_volume(path)
    for level, shape in ((1, (70, 75, 75)), (2, (70, 38, 38))):
        coarse = io.open_volume(path, level=level)
        assert coarse.shape == shape
        got = coarse.read(whole_box(shape))
        assert got.any()
        for place in np.argwhere(got)[::97]:
            at = finest.geometry.world_to_index(coarse.geometry.index_to_world(place))
            np.testing.assert_allclose(at, np.rint(at), atol=1e-6)
            assert array[tuple(np.rint(at).astype(int))] == got[tuple(place)]
    yaozarrs.validate_zarr_store(path)
    yaozarrs.validate_zarr_store(tmp_path / "scan.ome.zarr")
    said = json.loads((path / "zarr.json").read_text())["attributes"]["ome"]["image-label"]
    assert said["source"] == {"image": "../scan.ome.zarr"}
    values = [entry["label-value"] for entry in said["colors"]]
    assert (
        values == sorted(set(np.unique(array)) - {0})
        and len({tuple(e["rgba"]) for e in said["colors"]}) > 600
    )


def test_chunks_of_zeros_are_not_in_the_store(tmp_path):
    with io.LabelStore(tmp_path / "a.ome.zarr", GRID, np.uint8) as store:
        store.write(whole_box(GRID.shape), np.zeros(GRID.shape, np.uint8))
        store.write(box_at((65, 0, 0), (1, 1, 1)), np.ones((1, 1, 1), np.uint8))
    chunks = [name for name in contents(tmp_path / "a.ome.zarr") if "/c/" in name]
    assert "0/c/1/0/0" in chunks and len([name for name in chunks if name.startswith("0/")]) == 1
