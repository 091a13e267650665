import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import AccelsurfError, GeometryError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure.surface_mesh import extract_surface
from accelsurf.text.starts import extent_hint, parse_start, psi_of_starts, read_starts

TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def grid(shape=(12, 14, 16), spacing=(3.0, 1.0, 0.5), origin=(-3.0, 5.0, 7.0), direction=None):
    return Geometry(shape, spacing, origin, np.eye(3) if direction is None else direction)


def world(geometry):
    return geometry.index_to_world(np.moveaxis(np.indices(geometry.shape), 0, -1))


@pytest.mark.parametrize("direction", [None, TURN])
def test_ball_is_a_distance_in_world_mm(direction):
    geometry = grid(direction=direction)
    center = geometry.index_to_world((5.0, 6.0, 8.0))
    text = "ball:" + ",".join(f"{v!r}" for v in center.tolist()) + ",4"
    psi = psi_of_starts(read_starts([text]), Volume(np.zeros(geometry.shape), geometry))
    exact = np.linalg.norm(world(geometry) - center, axis=-1) - 4
    assert psi.dtype == np.float32
    assert np.abs(psi - exact).max() < 1e-5


def test_box_lies_along_the_world_axes_of_an_oblique_grid():
    geometry = grid(direction=TURN, spacing=(1.0, 1.0, 1.0))
    low, high = np.array([-2.0, 8.0, 9.0]), np.array([4.0, 15.0, 14.0])
    text = "box:" + ",".join(str(v) for v in (*low, *high))
    psi = psi_of_starts(read_starts([text]), Volume(np.zeros(geometry.shape), geometry))
    inside = ((world(geometry) > low) & (world(geometry) < high)).all(axis=-1)
    assert inside.sum() > 20
    np.testing.assert_array_equal(psi < 0, inside)
    # A distance: nowhere steeper than 1 per mm.
    assert np.abs(np.diff(psi, axis=1)).max() <= 1 + 1e-5


def test_vox_counts_voxels_in_the_order_x_y_z():
    geometry = grid(direction=TURN)
    psi = psi_of_starts(
        read_starts(["ball:8,6,5,3vox"]), Volume(np.zeros(geometry.shape), geometry)
    )
    assert np.unravel_index(psi.argmin(), psi.shape) == (5, 6, 8)
    # The radius is in voxels of the smallest spacing, 0.5 mm.
    assert psi.min() == pytest.approx(-1.5)
    psi = psi_of_starts(
        read_starts(["box:2,3,4,10,9,6vox"]), Volume(np.zeros(geometry.shape), geometry)
    )
    z, y, x = np.nonzero(psi < 0)
    assert (z.min(), y.min(), x.min()) == (5, 4, 3) and (z.max(), y.max(), x.max()) == (5, 8, 9)


def test_starts_are_united():
    volume = Volume.from_array(np.zeros((16, 16, 16)))
    one, two = (
        psi_of_starts(read_starts([s]), volume) for s in ("ball:4,4,4,2", "box:8,8,8,12,12,12")
    )
    both = psi_of_starts(read_starts(["ball:4,4,4,2", "box:8,8,8,12,12,12"]), volume)
    np.testing.assert_array_equal(both, np.minimum(one, two))


def test_center_is_a_quarter_of_the_smallest_extent():
    volume = Volume.from_array(np.zeros((10, 20, 31)), (2.0, 1.0, 1.0))
    psi = psi_of_starts(read_starts(["center"]), volume)
    assert psi.min() == pytest.approx(-5.0, abs=1.2)
    z, y, x = np.nonzero(psi < 0)
    assert (z.mean(), y.mean(), x.mean()) == pytest.approx((4.5, 9.5, 15.0))
    # The slice of a 2D image does not count as an extent.
    flat = psi_of_starts(read_starts(["center"]), Volume.from_array(np.zeros((1, 20, 24))))
    assert flat.min() == pytest.approx(-5.0, abs=0.8)


def test_threshold_is_in_the_image_s_units_and_includes_its_ends():
    array = np.arange(27, dtype=np.int16).reshape(3, 3, 3)
    psi = psi_of_starts(read_starts(["threshold:5,9"]), Volume.from_array(array))
    np.testing.assert_array_equal(psi < 0, (array >= 5) & (array <= 9))
    smoothed = array.astype(np.float32) + 100
    psi = psi_of_starts(read_starts(["threshold:105,109"]), Volume.from_array(array), smoothed)
    np.testing.assert_array_equal(psi < 0, (array >= 5) & (array <= 9))


def test_label_map(tmp_path):
    geometry = grid()
    labels = np.zeros(geometry.shape, np.uint8)
    labels[3:6, 4:9, 5:11] = 7
    io.write(Volume(labels, geometry), tmp_path / "start.nii.gz")
    psi = psi_of_starts(
        read_starts([f"label:{tmp_path / 'start.nii.gz'}"]),
        Volume(np.zeros(geometry.shape), geometry),
    )
    np.testing.assert_array_equal(psi < 0, labels > 0)


def test_label_map_on_another_grid_is_refused(tmp_path):
    geometry = grid()
    io.write(Volume(np.ones(geometry.shape, np.uint8), geometry), tmp_path / "start.nii.gz")
    other = Volume(np.zeros(geometry.shape), grid(origin=(0.0, 0.0, 0.0)))
    with pytest.raises(GeometryError, match="on another grid"):
        psi_of_starts(read_starts([f"label:{tmp_path / 'start.nii.gz'}"]), other)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sphere:1,2,3,4", "unknown kind 'sphere'"),
        ("ball:1,2,3", "4 numbers"),
        ("ball:1,2,three,4", "4 numbers"),
        ("ball:1,2,3,nan", "4 numbers"),
        ("ball:1,2,inf,4", "finite"),
        ("ball:1,2,3,0", "expected above 0"),
        ("box:0,0,0,1,1", "6 numbers"),
        ("box:5,0,0,1,1,1", "must lie below"),
        ("threshold:9,5", "low threshold is above"),
        ("label:", "no file"),
        ("center:1", "takes no values"),
        ("", "unknown kind"),
    ],
)
def test_what_cannot_be_parsed_is_told_in_one_line(text, words):
    with pytest.raises(UsageError, match=words) as caught:
        parse_start(text)
    assert "\n" not in str(caught.value) and caught.value.hint


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ball:500,0,0,3", "no voxel centre is inside"),
        ("ball:8.5,8.5,8.5,0.2", "no voxel centre is inside"),
        ("box:-9,-9,-9,-5,-5,-5", "no voxel centre is inside"),
        ("threshold:50,60", "no voxel lies between"),
        ("ball:8,8,8,100", "every voxel"),
        ("threshold:-inf,inf", "every voxel"),
    ],
)
def test_starts_that_are_outside_empty_or_full(text, words):
    volume = Volume.from_array(np.arange(16.0**3).reshape(16, 16, 16) % 20)
    with pytest.raises(InputError, match=words) as caught:
        psi_of_starts(read_starts([text]), volume)
    assert caught.value.exit_code == 3 and caught.value.hint


def test_an_empty_label_map_and_a_missing_one(tmp_path):
    volume = Volume.from_array(np.zeros((4, 4, 4)))
    io.write(Volume.from_array(np.zeros((4, 4, 4), np.uint8)), tmp_path / "empty.nrrd")
    with pytest.raises(InputError, match="has no voxel of these labels"):
        psi_of_starts(read_starts([f"label:{tmp_path / 'empty.nrrd'}"]), volume)
    with pytest.raises(AccelsurfError):
        psi_of_starts(read_starts([f"label:{tmp_path / 'missing.nrrd'}"]), volume)


# ------------------------------------------------------------------------------ seeds, largest part, Otsu, ids, meshes


@pytest.mark.parametrize("direction", [None, TURN])
def test_a_seed_grows_to_its_radius_and_stops_at_edges(direction):
    geometry = grid((30, 40, 60), (1.5, 1.0, 0.7), direction=direction)
    centre = geometry.center_world()
    r = np.linalg.norm(world(geometry) - centre, axis=-1)
    text = "seed:" + ",".join(f"{v!r}" for v in centre.tolist()) + ","
    values = np.random.default_rng(1).normal(100, 1, geometry.shape)
    values[:2] = 200
    flat = Volume(values, geometry)
    ball = psi_of_starts(read_starts([text + "9"]), flat) < 0
    # Ways along the 26 neighbours are up to a fifth longer than straight ones here, and begin at a voxel's centre.
    assert (r[ball] <= 10).all() and (ball[r < 6.5]).all()
    scan = Volume(
        np.where(r < 8, 100.0, 0.0) + np.random.default_rng(1).normal(0, 2, geometry.shape),
        geometry,
    )
    held = psi_of_starts(read_starts([text + "25"]), scan) < 0
    assert np.count_nonzero(held != (r < 8)) < 0.06 * np.count_nonzero(r < 8)


def test_a_seed_in_voxels_and_one_outside():
    volume = Volume.from_array(np.random.default_rng(1).normal(size=(20, 20, 20)), (2.0, 1.0, 1.0))
    psi = psi_of_starts(read_starts(["seed:8,9,5,3vox"]), volume)
    z, y, x = np.nonzero(psi < 0)
    assert (round(z.mean()), round(y.mean()), round(x.mean())) == (5, 9, 8)
    with pytest.raises(InputError, match="no voxel centre"):
        psi_of_starts(read_starts(["seed:80,9,5,3vox"]), volume)


def test_the_largest_part_and_otsu():
    array = np.random.default_rng(1).uniform(0, 1, (20, 30, 30))
    array[4:14, 4:14, 4:14] += 100
    array[16:19, 20:28, 20:28] += 100
    volume = Volume.from_array(array)
    both = psi_of_starts(read_starts(["otsu"]), volume) < 0
    assert both[8, 8, 8] and both[17, 24, 24] and both.sum() == 1000 + 3 * 64
    for text in ("largest:50,150", "largest:otsu"):
        one = psi_of_starts(read_starts([text]), volume) < 0
        assert one.sum() == 1000 and one[8, 8, 8]
    dark = psi_of_starts(read_starts(["otsu:dark"]), volume) < 0
    np.testing.assert_array_equal(dark, ~both)
    np.testing.assert_array_equal(
        psi_of_starts(read_starts(["largest:otsu:dark"]), volume) < 0, ~both
    )


def test_label_ids(tmp_path):
    geometry = grid()
    labels = np.arange(np.prod(geometry.shape), dtype=np.int16).reshape(geometry.shape) // 100
    path = tmp_path / "st@rt.nii.gz"
    io.write(Volume(labels, geometry), path)
    volume = Volume(np.zeros(geometry.shape), geometry)
    for ids, want in (("3", [3]), ("2,7-9", [2, 7, 8, 9])):
        psi = psi_of_starts(read_starts([f"label:{path}@{ids}"]), volume)
        np.testing.assert_array_equal(psi < 0, np.isin(labels, want))
    with pytest.raises(InputError, match="the label map has no voxel of these labels"):
        psi_of_starts(read_starts([f"label:{path}@999"]), volume)


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj"])
def test_a_closed_mesh_gives_its_voxels_back(tmp_path, suffix):
    geometry = grid((24, 30, 36), (1.5, 1.0, 0.7), direction=TURN)
    centre = geometry.center_world()
    r = np.linalg.norm(world(geometry) - centre - (2.0, 0.0, 1.0), axis=-1) - 8
    volume = Volume(np.zeros(geometry.shape), geometry)
    for space in ("lps", "ras"):
        path = tmp_path / f"{space}.{suffix}"
        extract_surface(r.astype(np.float32), geometry).write(path, space)
        psi = psi_of_starts(read_starts([f"mesh:{path}@{space}"]), volume)
        # Vertices lie above the surface as far as triangles lie below it: voxels in between may fall to either side.
        differ = (psi < 0) != (r < 0)
        assert np.abs(r[differ]).max(initial=0.0) < 1.5**2 / 6 / 8


def test_meshes_that_are_open_missing_or_damaged(tmp_path):
    geometry = grid()
    volume = Volume(np.zeros(geometry.shape), geometry)
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n")
    (tmp_path / "bad.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    (tmp_path / "mesh.txt").write_text("")
    for name, words in (
        ("open.obj", "1 triangles with 3 open edges"),
        ("bad.ply", "mesh|triangles"),
        ("mesh.txt", "no mesh format"),
        ("absent.ply", "no such file"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            psi_of_starts(read_starts([f"mesh:{tmp_path / name}"]), volume)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed:1,2,3", "4 numbers"),
        ("seed:1,2,3,0", "expected above 0"),
        ("largest:9,5", "low threshold is above"),
        ("largest:bright", "2 numbers"),
        ("otsu:bright", "otsu or otsu:dark"),
        ("otsu:", "otsu or otsu:dark"),
        ("mesh:", "no file"),
        ("label:a.nii@", "is no label"),
        ("label:a.nii@3-1", "is no label"),
        ("label:a.nii@x", "is no label"),
        ("label:@3", "no file"),
    ],
)
def test_bad_words_of_the_new_kinds(text, words):
    with pytest.raises(UsageError, match=words):
        parse_start(text)


@pytest.mark.parametrize("unit", ["mm", "um"])
@pytest.mark.parametrize("degrees", [0.0, 10.0])
def test_a_hint_says_where_the_volume_lies_and_proposes_no_system(degrees, unit):
    """A place that happens to be inside in another system is no sign that it was meant so."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    geometry = Geometry((60, 50, 40), (2.0, 1.0, 1.0), (-100.0, -80.0, -900.0), turn, unit)
    hint = extent_hint(geometry)
    assert f" {unit} (world, LPS)" in hint and all(end in hint for end in ("ras", "vox", "grid"))
    assert ("z -900 to -782" if unit == "mm" else "z -9e+05 to -7.82e+05") in hint
    assert ("x' 0 to" in hint) == (degrees > 0)
    assert "inside" not in hint and "?" not in hint
