import csv
import json

import numpy as np
import pytest
from scipy import ndimage

import accelsurf
from accelsurf import cli, io
from accelsurf.api.segment import segment_objects
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.evolution.records import Stop
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.levelset import LevelSet
from accelsurf.levelset.transfer import shift_fields
from accelsurf.measure.metrics import dice
from accelsurf.phantoms import recipes
from accelsurf.run.ensemble import overall_stop
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.objects import read_objects

ISOTROPIC = (1.0, 1.0, 1.0)


def distances(shape, spacing, centres, radius):
    """Signed distance (mm) to each of some balls; centres (z, y, x) in mm."""
    places = [i * h for i, h in zip(np.indices(shape).astype(float), spacing, strict=True)]
    return [
        np.sqrt(sum((p - c) ** 2 for p, c in zip(places, centre, strict=True))) - radius
        for centre in centres
    ]


def scene(shape, spacing, centres, radius, noise=0.3, seed=0):
    """An image of balls of one brightness, and the truth: what two hold is the one's that is deeper there."""
    away = np.array(distances(shape, spacing, centres, radius))
    truth = np.where(away.min(axis=0) < 0, away.argmin(axis=0) + 1, 0)
    image = np.clip(0.5 - away.min(axis=0) / min(spacing), 0, 1)
    image += np.random.default_rng(seed).normal(0, noise, shape)
    return image.astype(np.float32), truth


def seeds(shape, spacing, centres, radius, ids):
    """A label map of small balls."""
    labels = np.zeros(shape, np.int32)
    for own, away in zip(ids, distances(shape, spacing, centres, radius), strict=True):
        labels[away < 0] = own
    return labels


GRIDS = {
    "isotropic": ((32, 32, 52), ISOTROPIC),
    "1 x 1 x 2.5 mm": ((14, 32, 52), (2.5, 1.0, 1.0)),
}


@pytest.fixture(scope="module", params=GRIDS)
def two(request):
    """Two balls of 10 mm, 16 mm apart, in noise."""
    shape, spacing = GRIDS[request.param]
    centres = [(16.0, 15.5, 17.0), (16.0, 15.5, 33.0)]
    image, truth = scene(shape, spacing, centres, 10.0)
    starts = seeds(shape, spacing, centres, 4.5, (7, 300))
    return image, truth, starts, spacing, segment_objects(image, starts, spacing=spacing)


def test_two_balls_that_touch_part_at_the_plane_between_them(two):
    image, truth, starts, spacing, result = two
    assert list(result.by_id) == [7, 300] and result.labels.dtype == np.uint16
    assert {one.stop.reason for one in result.objects} == {"converged"}
    for own, true in ((7, 1), (300, 2)):
        assert dice(result.labels == own, truth == true) >= 0.97
        assert result.by_id[own].components == 1
    # On the common plane, x = 25 mm, and nowhere beyond it by more than half a voxel.
    for own, sign in ((7, 1.0), (300, -1.0)):
        beyond = sign * (result.by_id[own].surface.vertices[:, 0] - 25.0)
        assert beyond.max() <= 0.75


@pytest.fixture(scope="module")
def touching():
    """The phantom two_balls at 5/9 of its size: balls that touch in one point, along x."""
    return recipes.make(recipes.load_recipe("two_balls").changed(shape=(52, 32, 32), radius=10.0))


def balls(path, *rows):
    path.write_text("id,x,y,z,r\n" + "".join(f"{','.join(map(str, row))}\n" for row in rows))
    return str(path)


def test_phantom_of_two_balls_from_a_ball_in_each(touching, tmp_path):
    table = balls(tmp_path / "s.csv", (1, -11, 0, 0, 4), (2, 11, 0, 0, 4))
    result = segment_objects(touching.image, table)
    assert result.stop.reason == "converged"
    assert dice(result.labels > 0, touching.truth.array) >= 0.97
    for one, sign in ((1, -1.0), (2, 1.0)):
        assert result.by_id[one].volume_mm3 == pytest.approx(4 / 3 * np.pi * 10**3, rel=0.05)
        assert (sign * result.by_id[one].surface.vertices[:, 0]).min() >= -1.0


@pytest.mark.slow
def test_starts_in_the_background_take_the_background_and_that_is_told(touching, tmp_path):
    # Beside both balls: two means, one of which is the background's, say that the object is the background.
    table = balls(tmp_path / "s.csv", (1, 0, 0, -11, 3), (2, 0, 0, 11, 3))
    result = segment_objects(touching.image, table, max_steps=60)
    taken = result.labels > 0
    assert np.count_nonzero(taken & (touching.truth.array > 0)) < 0.02 * np.count_nonzero(taken)
    for one in result.objects:
        assert any(warning.startswith("border") for warning in one.quality.notes)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", ["constant-density", "flowable-mass"])
def test_mass_that_meets_mass_comes_to_rest_and_gains_no_energy(flow):
    shape, centres = (22, 22, 36), [(10.5, 10.5, 11.0), (10.5, 10.5, 24.0)]
    image, truth = scene(shape, ISOTROPIC, centres, 8.0, noise=0.1)
    result = segment_objects(
        image, seeds(shape, ISOTROPIC, centres, 3.5, (1, 2)), flow=flow, max_steps=400
    )
    for own, one in result.by_id.items():
        assert one.stop.reason == "converged"
        assert dice(result.labels == own, truth == own) >= 0.95
        rows = one.history
        energy = np.array(
            [row.potential + row.mass_potential + row.kinetic / row.weight for row in rows]
        )
        # Within one box U compares; kinetic energy is never more than the potential that was won.
        assert max(row.kinetic / row.weight for row in rows) <= rows[0].potential
        assert (
            np.isfinite(energy).all()
            and rows[-1].kinetic / rows[-1].weight < 0.02 * rows[0].potential
        )


def test_objects_within_a_mask(tmp_path):
    shape, centres = (20, 20, 36), [(9.5, 9.5, 11.0), (9.5, 9.5, 24.0)]
    image, truth = scene(shape, ISOTROPIC, centres, 7.5, noise=0.1)
    mask = np.zeros(shape, np.uint8)
    mask[:, :10, :30] = 1
    io.write_labels(Volume(mask, Geometry(shape, ISOTROPIC)), tmp_path / "mask.nii.gz")
    starts = seeds(shape, ISOTROPIC, centres, 3.5, (1, 2))
    result = segment_objects(image, starts, mask=str(tmp_path / "mask.nii.gz"))
    assert result.stop.reason == "converged"
    assert not (result.labels[mask == 0] > 0).any()
    for own in (1, 2):
        assert dice(result.labels == own, (truth == own) & (mask > 0)) >= 0.93
    mask[:, :, 16:] = 0
    io.write_labels(Volume(mask, Geometry(shape, ISOTROPIC)), tmp_path / "mask.nii.gz")
    with pytest.raises(InputError, match="object 2: its start lies outside of the mask"):
        segment_objects(image, starts, mask=str(tmp_path / "mask.nii.gz"))


def test_no_voxel_is_in_two(two):
    *_, result = two
    psi = np.full((2, *result.labels.shape), 1.0, np.float32)
    for place, own in enumerate(result.by_id):
        psi[place][result.by_id[own].box] = result.by_id[own].psi
    assert not ((psi[0] < 0) & (psi[1] < 0)).any()
    assert np.array_equal(psi[0] < 0, result.labels == 7) and np.array_equal(
        psi[1] < 0, result.labels == 300
    )
    assert np.array_equal(result.psi < 0, result.labels > 0)


@pytest.mark.sampled(1)
@pytest.mark.threads
def test_same_bytes_for_any_number_of_threads_and_any_order_of_labels_in_memory(two):
    image, _, starts, spacing, result = two
    again = segment_objects(image, np.asfortranarray(starts), spacing=spacing, threads=3)
    assert again.labels.tobytes() == result.labels.tobytes()
    for own, one in result.by_id.items():
        assert again.by_id[own].psi.tobytes() == one.psi.tobytes()
        assert [row._replace(seconds=0) for row in again.by_id[own].history] == [
            row._replace(seconds=0) for row in one.history
        ]


@pytest.mark.slow
def test_three_balls_that_meet_in_a_line():
    shape, radius = (28, 46, 46), 9.5
    angles = np.deg2rad([90.0, 210.0, 330.0])
    centres = [(13.5, 22.5 + 9.0 * np.sin(a), 22.5 + 9.0 * np.cos(a)) for a in angles]
    image, truth = scene(shape, ISOTROPIC, centres, radius, noise=0.2)
    result = segment_objects(image, seeds(shape, ISOTROPIC, centres, 4.0, (1, 2, 3)))
    assert result.stop.reason == "converged"
    for own in (1, 2, 3):
        assert dice(result.labels == own, truth == own) >= 0.96
    # Where all three meet nobody is left out.
    assert (result.labels[13, 21:25, 21:25] > 0).all()


@pytest.mark.slow
def test_objects_that_meet_at_the_border_come_to_rest():
    # Their contact runs aslant into four faces of the volume: the surface points nearest to voxels there lie beyond.
    image = np.zeros((14, 22, 40), np.float32)
    image[:, :, 4:36] = 1.0
    image += np.random.default_rng(0).normal(0, 0.1, image.shape).astype(np.float32)
    starts = np.zeros(image.shape, np.uint8)
    starts[3:7, 15:19, 9:13], starts[7:11, 3:7, 22:26] = 1, 2
    result = segment_objects(
        image, starts, spacing=(2.2, 1.0, 1.0), energy="threshold:0.5,", max_steps=120
    )
    assert result.stop.reason == "converged"
    assert np.count_nonzero(result.labels[:, :, 5:35]) >= 0.995 * 14 * 22 * 30
    assert sum(row.removed_components for one in result.objects for row in one.history) <= 5


def test_none_swallows_another_that_is_alike():
    # One even block, and more background on one side than on the other: the models differ, the objects do not.
    image = np.zeros((16, 16, 50), np.float32)
    image[3:13, 3:13, 3:27] = 1.0
    starts = np.zeros(image.shape, np.uint8)
    starts[6:10, 6:10, 5:10], starts[6:10, 6:10, 20:25] = 1, 2
    result = segment_objects(image, starts)
    assert result.stop.reason == "converged"
    sizes = [np.count_nonzero(result.labels == own) for own in (1, 2)]
    assert sum(sizes) == pytest.approx(image.sum(), rel=0.06) and min(sizes) > 0.4 * sum(sizes)


@pytest.mark.slow
def test_who_would_rather_give_way_does():
    # Object 1 begins with a part of the bright object 2, which its own model does not want.
    image = np.zeros((16, 16, 40), np.float32)
    image[3:13, 3:13, 3:20], image[3:13, 3:13, 20:37] = 1.0, 2.5
    starts = np.zeros(image.shape, np.uint8)
    starts[5:11, 5:11, 5:23], starts[5:11, 5:11, 23:34] = 1, 2
    result = segment_objects(image, starts, energy="threshold:0.5,1.75")
    bright = segment_objects(image, starts, energy="likelihood", max_steps=200)
    assert np.count_nonzero(result.labels[:, :, 22:] == 1) == 0
    assert np.count_nonzero(bright.labels[4:12, 4:12, 21:36] == 2) >= 0.95 * 8 * 8 * 15


def test_cost_goes_with_the_surfaces_not_with_the_volume_times_their_number():
    def cells(count, wide):
        shape = (20, 20, 20 * count + wide)
        centres = [(9.5, 9.5, 9.5 + 20 * i) for i in range(count)]
        image, _ = scene(shape, ISOTROPIC, centres, 6.0, noise=0.0)
        result = segment_objects(
            image, seeds(shape, ISOTROPIC, centres, 4.0, range(1, count + 1)), max_steps=15
        )
        assert max(one.labels.shape[2] for one in result.objects) < 45
        return [sum(row.cells_visited for row in one.history) for one in result.objects]

    one, four = cells(1, 80), cells(4, 20)
    assert sum(four) == pytest.approx(4 * one[0], rel=0.15)


@pytest.mark.slow
def test_a_grid_that_grows_changes_nothing_for_an_energy_that_sees_only_the_place():
    shape, centres = (30, 30, 90), [(14.5, 14.5, 40.0)]
    image, _ = scene(shape, ISOTROPIC, centres, 11.0, noise=0.1)
    told = {"energy": "threshold:0.5,", "levels": 1, "max_steps": 120}
    starts = seeds(shape, ISOTROPIC, [(14.5, 14.5, 47.0)], 2.6, (1,))
    many = segment_objects(image, starts, **told)
    alone = accelsurf.segment(Volume.from_array(image), **told, start="ball:47,14.5,14.5,2.6")
    assert (
        many.by_id[1].labels.shape[2] < 90 and many.stop.reason == alone.stop.reason == "converged"
    )
    assert dice(many.labels, alone.labels) >= 0.999


def test_fields_on_a_larger_grid_are_those_of_the_same_places():
    psi = distances((20, 20, 20), ISOTROPIC, [(9.3, 9.6, 9.9)], 5.2)[0].astype(np.float32)
    old, new = LevelSet(psi[3:, 2:, 1:], ISOTROPIC), LevelSet(psi, ISOTROPIC)
    place = np.stack(np.unravel_index(old.band.cells, old.shape))
    (field,) = shift_fields([place[0].astype(np.float32)], old, (3, 2, 1), new, (0, 0, 0))
    there = np.stack(np.unravel_index(new.band.cells, new.shape))[0] - 3
    front = new.front()
    assert front.sum() > 500 and np.array_equal(field[front], there[front].astype(np.float32))


def test_an_object_that_vanishes_is_a_row_and_the_others_stay():
    image, truth = scene((24, 24, 40), ISOTROPIC, [(11.5, 11.5, 12.0)], 7.0, noise=0.05)
    starts = seeds(image.shape, ISOTROPIC, [(11.5, 11.5, 12.0), (11.5, 11.5, 33.0)], 3.5, (4, 2))
    result = segment_objects(image, starts, energy="threshold:0.5,")
    assert [one.stop.reason for one in result.objects] == ["vanished", "converged"]
    assert (
        result.stop.reason == "converged"
        and result.stop.message == "of 2 objects 1 converged, 1 vanished"
    )
    assert dice(result.labels == 4, truth == 1) > 0.97 and not (result.labels == 2).any()
    row = {one["id"]: one for one in result.report["objects"]}[2]
    assert row["volume_mm3"] == 0 and row["centroid"] is None and row["quality"] is None


def test_one_slice_mask_roi_and_largest_volume():
    image, _ = scene(
        (1, 40, 64), (5.0, 1.0, 1.0), [(0.0, 20.0, 20.0), (0.0, 20.0, 42.0)], 13.0, noise=0.2
    )
    starts = seeds(
        image.shape, (5.0, 1.0, 1.0), [(0.0, 20.0, 20.0), (0.0, 20.0, 42.0)], 5.0, (1, 2)
    )
    result = segment_objects(image[0], starts[0], spacing=(5.0, 1.0, 1.0))
    lens = 13**2 * (2 * np.arccos(11 / 13) - np.sin(2 * np.arccos(11 / 13))) / 2
    for one in result.objects:
        assert one.enclosed_mm2 == pytest.approx(np.pi * 13**2 - lens, rel=0.05)
        assert one.contours.length > 0
    cut = segment_objects(
        image[0], starts[0], spacing=(5.0, 1.0, 1.0), roi="0,0,-1,60,22,1vox", max_volume=1500
    )
    assert not cut.labels[:, 23:].any() and cut.by_id[1].geometry.shape[1] <= 25
    assert {one.stop.reason for one in cut.objects} <= {
        "leaked",
        "converged",
    } and cut.stop.reason == "leaked"


# ---------------------------------------------------------------------------------------------------------- starts


def test_tables_and_label_maps_say_the_same(tmp_path):
    geometry = Geometry((24, 24, 40), ISOTROPIC, (10.0, -5.0, 3.0))
    starts = seeds(geometry.shape, ISOTROPIC, [(11, 12, 12), (11, 12, 30)], 4.2, (9, 5))
    (tmp_path / "mm.csv").write_text("# balls\nid, x, y, z, r\n9,22,7,14,4.2\n5,40,7,14,4.2\n")
    (tmp_path / "vox.csv").write_text(
        "r_vox,id,x_vox,y_vox,z_vox\n4.2,9,12,12,11\n4.2,5,30,12,11\n"
    )
    io.write_labels(Volume(starts, geometry), tmp_path / "starts.nii.gz")
    found = {
        name: read_objects(str(tmp_path / name), geometry, 2)
        for name in ("mm.csv", "vox.csv", "starts.nii.gz")
    }
    for read in found.values():
        assert [one.id for one in read] == [5, 9]
        for one in read:
            labels = np.zeros(geometry.shape, bool)
            labels[
                tuple(slice(c, c + n) for c, n in zip(one.corner, one.psi.shape, strict=True))
            ] = one.psi < 0
            assert np.array_equal(labels, starts == one.id)
    only = read_objects(f"{tmp_path / 'starts.nii.gz'}@6-9", geometry, 2)
    assert [one.id for one in only] == [9]


def test_balls_that_overlap_part_in_the_middle_and_a_tie_goes_to_the_lowest_id(tmp_path):
    (tmp_path / "s.csv").write_text("id,x,y,z,r\n8,12,8,8,5\n3,8,8,8,5\n")
    low, high = read_objects(str(tmp_path / "s.csv"), Geometry((17, 17, 21), ISOTROPIC), 2)
    x = [np.argwhere(one.psi < 0)[:, 2] + one.corner[2] for one in (low, high)]
    assert (low.id, x[0].max(), x[1].min()) == (3, 10, 11)


GRID = Geometry((10, 12, 14), ISOTROPIC)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no line was given as the first line"),
        (
            "id,x,y,z\n1,2,3,4\n",
            "id,x,y,z was given as the first line, expected columns id,x,y,z,r",
        ),
        ("id,x,y,z,r\n", "has no row"),
        ("id,x,y,z,r\n1,5,5,5,2\n2,5,five,5,2\n", "line 3: 2,5,five,5,2 was given"),
        ("id,x,y,z,r\n1.5,5,5,5,2\n", "a whole number from 1 on"),
        ("id,x,y,z,r\n1,5,5,5,0\n", "line 2: radius 0 was given"),
        ("id,x,y,z,r\n3,50,5,5,2\n", "ball 3 lies outside of the volume"),
        ("id,x,y,z,r\n3,5.5,5.5,5.5,0.4\n", "no voxel centre is inside ball 3"),
        ("id,x,y,z,r\n1,5,5,5,4\n2,5,5,5,2\n", "all of object 2 lies within others"),
    ],
)
def test_bad_tables_are_told(text, told, tmp_path):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(InputError, match=told):
        read_objects(str(tmp_path / "s.csv"), GRID, 2)


def test_bad_label_maps_are_told(tmp_path):
    with pytest.raises(InputError, match="no voxel has a label above 0"):
        read_objects(np.zeros(GRID.shape, int), GRID, 2)
    with pytest.raises(GeometryError, match="shape"):
        read_objects(np.ones((3, 3, 3), int), GRID, 2)
    with pytest.raises(InputError, match="must be whole numbers"):
        read_objects(np.full(GRID.shape, 0.5), GRID, 2)
    with pytest.raises(GeometryError, match="on another grid"):
        read_objects(
            Volume(np.ones(GRID.shape, int), Geometry(GRID.shape, (1.0, 1.0, 2.0))), GRID, 2
        )
    with pytest.raises(InputError, match="cannot be read|does not exist"):
        read_objects(str(tmp_path / "absent.csv"), GRID, 2)


def test_settings_that_do_not_go_together():
    with pytest.raises(UsageError, match="start: ball:1,2,3,4 was given with objects"):
        RunConfig(objects="a.csv", start="ball:1,2,3,4")
    image = np.zeros(GRID.shape)
    image[2:6, 2:6, 2:6] = 1
    with pytest.raises(UsageError, match="nothing was given"):
        segment_objects(image)


# ------------------------------------------------------------------------------------------------------ command line


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    image, _ = scene((20, 20, 36), ISOTROPIC, [(9.5, 9.5, 11.0), (9.5, 9.5, 24.0)], 7.0, noise=0.1)
    io.write(Volume(image, Geometry(image.shape, ISOTROPIC)), folder / "cells.nii.gz")
    (folder / "starts.csv").write_text(
        "id,x,y,z,r\n12,11,9.5,9.5,3\n700,24,9.5,9.5,3\n3,33,3,3,2.4\n"
    )
    return folder


def run(*words):
    return cli.execute([str(word) for word in words])


def test_command_line_from_a_table_to_labels_meshes_and_rows(scan, tmp_path, capsys):
    words = (
        "segment",
        scan / "cells.nii.gz",
        "--objects",
        scan / "starts.csv",
        "--energy",
        "threshold:0.5,",
    )
    assert run(*words, "-o", tmp_path, "--mesh", "ply,stl", "--save-sdf") == 0
    said = capsys.readouterr()
    assert (
        "of 3 objects 2 converged, 1 vanished" in said.out
        and "warning: object 3: vanished" in said.err
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        f"cells_{name}"
        for name in (
            *(
                "seg.nii.gz",
                "sdf.nii.gz",
                "surface_12.ply",
                "surface_12.stl",
                "surface_700.ply",
                "surface_700.stl",
            ),
            *(
                "objects.csv",
                "report.json",
                "trace.csv",
                "preview.png",
                "statistics.csv",
                "statistics.json",
            ),
        )
    )
    labels = io.read_labels(tmp_path / "cells_seg.nii.gz")
    assert labels.array.dtype == np.uint16 and set(np.unique(labels.array)) == {0, 12, 700}
    rows = list(csv.DictReader((tmp_path / "cells_objects.csv").read_text().splitlines()))
    assert [row["id"] for row in rows] == ["3", "12", "700"]
    assert [row["reason"] for row in rows] == ["vanished", "converged", "converged"]
    assert float(rows[1]["x_mm"]) == pytest.approx(11.0, abs=0.3)
    document = json.loads((tmp_path / "cells_report.json").read_text())
    assert document["status"] == "ok" and [one["id"] for one in document["objects"]] == [3, 12, 700]
    assert document["volume_mm3"] == pytest.approx(
        sum(one["volume_mm3"] for one in document["objects"])
    )
    trace = list(csv.DictReader((tmp_path / "cells_trace.csv").read_text().splitlines()))
    assert {row["object"] for row in trace} == {"3", "12", "700"}
    # Once more: refused, told to be strict, and with nothing left.
    assert run(*words, "-o", tmp_path) == 7
    assert run(*words, "-o", tmp_path, "--overwrite", "--strict") == 5
    assert "object 3: vanished" in capsys.readouterr().err
    # Meshes of the earlier run go, of any format; what a person put there stays.
    (tmp_path / "cells_surface_notes.ply").write_text("mine")
    (tmp_path / "cells_surface_012.ply").write_text("mine")
    (scan / "fewer.csv").write_text("id,x,y,z,r\n12,11,9.5,9.5,3\n")
    fewer = (
        "segment",
        scan / "cells.nii.gz",
        "--objects",
        scan / "fewer.csv",
        "--energy",
        "threshold:0.5,",
    )
    assert run(*fewer, "-o", tmp_path, "--overwrite", "--quiet") == 0
    assert sorted(path.name for path in tmp_path.glob("*surface*")) == [
        "cells_surface_012.ply",
        "cells_surface_12.ply",
        "cells_surface_notes.ply",
    ]
    assert run(*words[:-1], "threshold:5,", "-o", tmp_path / "none") != 0
    assert not list((tmp_path / "none").glob("*surface*"))


def test_command_line_tells_bad_objects(scan, tmp_path, capsys):
    assert (
        run("segment", scan / "cells.nii.gz", "--objects", scan / "absent.nii.gz", "-o", tmp_path)
        == 3
    )
    assert (
        run(
            "segment",
            scan / "cells.nii.gz",
            "--objects",
            "a.csv",
            "--start",
            "otsu",
            "-o",
            tmp_path,
        )
        == 2
    )
    err = capsys.readouterr().err
    assert "absent.nii.gz" in err and "expected one of the two" in err


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "energy", ["threshold:learned,learned", "threshold:half:0,", "likelihood:update=no"]
)
def test_each_object_learns_from_its_own_start(energy):
    """Two balls of other brightness, each beside something as bright as the other."""
    centres, shape = [(14.0, 14.0, 14.0), (14.0, 14.0, 42.0)], (28, 28, 56)
    away = distances(shape, ISOTROPIC, centres, 9.0)
    image = np.select([a < 0 for a in away], [300.0, 900.0], 0.0)
    image += np.random.default_rng(3).normal(0, 30, shape)
    result = segment_objects(
        image, seeds(shape, ISOTROPIC, centres, 5.0, (1, 2)), spacing=1.0, energy=energy
    )
    for own, truth in zip((1, 2), away, strict=True):
        assert dice(result.labels == own, truth < 0) > 0.95, own
    one, two = (result.by_id[own].terms[0] for own in (1, 2))
    told = [key for key in one if one[key] != two[key]]
    assert told and all(result.terms[0][key] == "by object" for key in told)
    assert result.by_id[1].quality.unlike_learned < 0.1


def test_what_is_given_as_foreground_is_learned_by_all(tmp_path):
    centres, shape = [(14.0, 14.0, 14.0), (14.0, 14.0, 42.0)], (28, 28, 56)
    away = distances(shape, ISOTROPIC, centres, 9.0)
    image = np.select([a < 0 for a in away], [300.0, 900.0], 0.0)
    image += np.random.default_rng(3).normal(0, 30, shape)
    starts = seeds(shape, ISOTROPIC, centres, 5.0, (1, 2))
    io.write_labels(
        Volume.from_array((starts == 2).astype(np.uint8), 1.0), tmp_path / "bright.nii.gz"
    )
    result = segment_objects(
        image,
        starts,
        spacing=1.0,
        energy="threshold:learned,",
        foreground=f"label:{tmp_path / 'bright.nii.gz'}",
    )
    assert (
        result.by_id[1].stop.reason == "vanished" and dice(result.labels == 2, away[1] < 0) > 0.95
    )
    assert result.terms == result.by_id[2].terms


@pytest.mark.slow
def test_touching_nuclei_of_other_brightness():
    """Seven ellipsoids, each touching some others, blurred and in noise, on voxels twice as high as wide."""
    spacing, shape = (2.0, 1.0, 1.0), (16, 56, 56)
    rng = np.random.default_rng(8)
    around = [
        (16.0, 28.0 + 14 * np.sin(a), 28.0 + 14 * np.cos(a)) for a in np.arange(6) * np.pi / 3
    ]
    z, y, x = (i * h for i, h in zip(np.indices(shape).astype(float), spacing, strict=True))
    centres = [(16.0, 28.0, 28.0), *around]
    away = [
        np.sqrt(((z - c[0]) / rng.uniform(0.9, 1.1)) ** 2 + (y - c[1]) ** 2 + (x - c[2]) ** 2) - 7.0
        for c in centres
    ]
    nearest = np.argmin(away, axis=0)
    truth = np.where(np.min(away, axis=0) < 0, nearest + 1, 0)
    brightness = np.array([0.0, *rng.uniform(0.6, 1.4, 7)])
    image = ndimage.gaussian_filter(brightness[truth], (0.5, 1.0, 1.0)) + rng.normal(0, 0.15, shape)
    result = segment_objects(
        image,
        seeds(shape, spacing, centres, 3.0, range(1, 8)),
        spacing=spacing,
        energy="threshold:half:0,",
        presmooth=1.0,
    )
    found = [dice(result.labels == own, truth == own) for own in range(1, 8)]
    print(f"touching nuclei: Dice {np.round(found, 3)}")
    assert min(found) > 0.85 and all(one.stop.reason == "converged" for one in result.objects)


@pytest.mark.parametrize(
    ("reasons", "said"),
    [
        (("given",), "1 object given"),
        (("converged",), "1 object converged"),
        (("converged", "vanished", "converged"), "of 3 objects 2 converged, 1 vanished"),
    ],
)
def test_the_end_of_one_object_is_not_counted(reasons, said):
    assert overall_stop([Stop(reason, 3, 1.0, "") for reason in reasons]).message == said
