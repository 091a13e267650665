"""Large phantoms: any box alone has the voxels of the whole, the truth is that of the image."""

import csv
import json

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.large import __main__ as command
from benchmarks.large.scene import Scene
from benchmarks.large.voxels import TREE, halved, image, truth

SIZE = 92


@pytest.fixture(scope="module")
def scene():
    return Scene.of(SIZE, seed=3, cells=20)


@pytest.fixture(scope="module")
def whole(scene):
    box = (slice(0, SIZE),) * 3
    return image(scene, box), truth(scene, box)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("chunk", [31, 64])
def test_a_box_alone_has_the_voxels_of_the_whole(scene, whole, chunk):
    for box in command.chunks(SIZE, chunk):
        np.testing.assert_array_equal(image(scene, box), whole[0][box])
        np.testing.assert_array_equal(truth(scene, box), whole[1][box])


def test_the_truth_is_that_of_the_image(whole):
    """Beyond the blurred edge all grey values are those of the label: noise is less than 28 grey values."""
    grey, labels = whole
    assert set(np.unique(labels)) == {0, *range(1, 21), TREE}
    thick = Scene.of(256, seed=3, cells=3)
    trunk, cell = (
        tuple(slice(round(at) - 12, round(at) + 12) for at in centre)
        for centre in (thick.capsules[0, 3:6], thick.centres[0])
    )
    for of_label, voxels, expected in (
        (labels == 0, grey, 60),
        (truth(thick, trunk) == TREE, image(thick, trunk), 170),
        (truth(thick, cell) == 1, image(thick, cell), 125),
    ):
        inner = (
            ndimage.distance_transform_edt(of_label) > 2.87
        )  # 2 to the surface, and half a diagonal
        assert inner.any() and np.abs(voxels[inner].astype(int) - expected).max() <= 28
        assert abs(voxels[inner].mean() - expected) < 0.3 + 4 * 8 / np.sqrt(inner.sum())
    away = ndimage.binary_erosion(labels == 0, iterations=4)
    assert grey[away].std() == pytest.approx(8.0, rel=0.02)


def test_noise_of_neighbours_and_of_seeds_is_independent(whole):
    empty = ndimage.binary_erosion(whole[1] == 0, iterations=4)
    noise = np.where(empty, whole[0] - 60.0, 0.0)
    other = image(Scene.of(SIZE, seed=4, cells=0), (slice(0, SIZE),) * 3) - 60.0
    for shifted in (
        np.roll(noise, 1, 2),
        np.roll(noise, 1, 1),
        np.roll(noise, 1, 0),
        np.where(empty, other, 0.0),
    ):
        both = (noise != 0) & (shifted != 0) & (np.abs(shifted) < 28)
        assert abs(np.corrcoef(noise[both], shifted[both])[0, 1]) < 0.02


def test_only_pairs_that_are_named_touch_and_no_cell_touches_the_tree(scene, whole):
    labels = whole[1].astype(int)
    met = set()
    for axis in range(3):
        a = np.moveaxis(labels, axis, 0)
        pairs = np.stack([a[:-1].ravel(), a[1:].ravel()])
        pairs = np.sort(pairs[:, (pairs[0] != pairs[1]) & (pairs > 0).all(axis=0)], axis=0)
        met |= {tuple(pair) for pair in pairs.T.tolist()}
    assert met == {tuple(pair) for pair in scene.touching.tolist()} and len(met) == 4


def test_the_tree_is_one_piece_that_spans_the_volume(whole):
    pieces, count = ndimage.label(whole[1] == TREE)
    assert count == 1
    capsules = Scene.of(512, cells=0).capsules
    ends = capsules[:, :6].reshape(-1, 3)
    assert (
        (np.ptp(ends, axis=0) > 0.75 * 512).all()
        and capsules[0, 6] == 12.8
        and capsules[:, 6].min() == 3.0
    )


def test_no_room_for_cells_is_said():
    with pytest.raises(ValueError, match="no room for cell"):
        Scene.of(40, cells=200)


@pytest.mark.slow
def test_means_of_blocks():
    fine = np.random.default_rng(0).integers(0, 256, (4, 6, 5)).astype(np.uint8)
    padded = np.pad(fine.astype(float), ((0, 0), (0, 0), (0, 1)), constant_values=np.nan)
    expected = np.rint(np.nanmean(padded.reshape(2, 2, 3, 2, 3, 2), axis=(1, 3, 5)))
    np.testing.assert_array_equal(halved(fine), expected)


def test_the_store(tmp_path):
    zarr = pytest.importorskip("zarr")
    words = ["--size", "75", "--cells", "4", "--seed", "5", "--chunk", "32", "--levels", "3"]
    command.main([str(tmp_path / "made"), *words])
    group = zarr.open_group(tmp_path / "made" / "image.ome.zarr", mode="r")
    scene = Scene.of(75, seed=5, cells=4)
    levels = [image(scene, (slice(0, 75),) * 3)]
    while len(levels) < 3:
        levels.append(halved(levels[-1]))
    for number, level in enumerate(levels):
        np.testing.assert_array_equal(group[str(number)][:], level)
    datasets = group.attrs["ome"]["multiscales"][0]["datasets"]
    assert [one["path"] for one in datasets] == ["0", "1", "2"]
    scale, move = datasets[2]["coordinateTransformations"]
    assert (
        scale["scale"] == [40.0] * 3 and move["translation"] == [15.0] * 3
    )  # micrometers; 4 voxels of 10
    labels = truth(scene, (slice(0, 75),) * 3)
    with (tmp_path / "made" / "cells.csv").open() as file:
        for row in csv.DictReader(file):
            at = np.array([float(row[name]) for name in "zyx"]) / command.SPACING_MM
            radius = float(row["r"]) / command.SPACING_MM
            ball = (
                np.linalg.norm(np.moveaxis(np.indices(labels.shape), 0, -1) - at, axis=-1) < radius
            )
            assert ball.any() and (labels[ball] == int(row["id"])).all()
    about = json.loads((tmp_path / "made" / "scene.json").read_text())
    root = tuple(round(v / command.SPACING_MM) for v in about["root_mm_xyz"][::-1])
    assert labels[root] == TREE
    with pytest.raises(FileExistsError):
        command.main([str(tmp_path / "made"), *words])
