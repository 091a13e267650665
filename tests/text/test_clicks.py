"""Clicks as they are written, and what is refused."""

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import GeometryError, InputError, UsageError
from accelsurf.grid.clicks import Clicks
from accelsurf.image.volume import Volume
from accelsurf.text.clicks import check_contradictions, read_clicks
from accelsurf.text.object_clicks import read_object_clicks, starts_of

SPACING = (3.0, 1.0, 0.5)


@pytest.fixture
def volume():
    return Volume.from_array(
        np.random.default_rng(0).normal(size=(10, 20, 30)).astype(np.float32), SPACING
    )


def voxels(clicks, side="inside", id=1):
    shape = (10, 20, 30)
    return {
        tuple(int(i) for i in v) for v in np.argwhere(Clicks(tuple(clicks), shape).mask(side, id))
    }


def test_a_point_is_the_voxel_that_it_lies_in(volume):
    assert voxels(read_clicks(["point:4.2,7.4,10.4"], "inside", volume)) == {(3, 7, 8)}
    assert voxels(read_clicks(["point:4,7,3vox"], "outside", volume), "outside") == {(3, 7, 4)}


@pytest.mark.parametrize(
    "text", ["ball:6,8,12,2.5", "ball:12,8,4,3vox", "box:2,2,3,6,6,12", "seed:6,8,12,2"]
)
def test_other_clicks_are_as_starts(volume, text):
    from accelsurf.text.starts import psi_of_starts, read_starts

    (click,) = read_clicks([text], "inside", volume)
    assert click.mask.any(axis=(1, 2)).all() and click.mask.any(axis=(0, 1)).all()
    # A voxel whose centre lies on a ball is clicked: a ball of one voxel has seven.
    least = 1e-5 if text.startswith("ball") else 0.0
    want = {
        tuple(int(i) for i in v)
        for v in np.argwhere(psi_of_starts(read_starts([text]), volume) < least)
    }
    assert voxels([click]) == want


@pytest.mark.parametrize(("radius", "count"), [(0.4, 1), (1.0, 7), (2.0, 33)])
def test_a_ball_and_a_pen_have_the_voxels_on_their_rim(radius, count):
    image = Volume.from_array(np.zeros((9, 9, 9), np.float32), 0.1)
    for text in (
        f"ball:.4,.4,.4,{0.1 * radius}",
        f"ball:4,4,4,{radius}vox",
        f"path:4,4,4,{radius}vox",
    ):
        (click,) = read_clicks([text], "inside", image)
        assert click.mask.sum() == count, text


def test_a_stroke_of_points_balls_and_sides(volume, tmp_path):
    file = tmp_path / "stroke.csv"
    file.write_text(
        "# a stroke\nx_vox, y_vox, z_vox, r_vox, side\n3,4,5,,\n4,4,5,,inside\n20,10,5,3,outside\n"
    )
    clicks = read_clicks([f"stroke:{file}"], "inside", volume)
    assert voxels(clicks) == {(5, 4, 3), (5, 4, 4)}
    ball = read_clicks(["ball:20,10,5,3vox"], "outside", volume)
    assert voxels(clicks, "outside") == voxels(ball, "outside")
    file.write_text("x,y,z\n1.5,4,15\n")
    assert voxels(read_clicks([f"stroke:{file}"], "outside", volume), "outside") == {(5, 4, 3)}


def test_a_stroke_of_labels_says_both_sides(volume, tmp_path):
    labels = np.zeros(volume.array.shape, np.uint8)
    labels[1, 2, 3:5], labels[8, 9, 10] = 1, 2
    file = tmp_path / "stroke.nrrd"
    io.write(Volume(labels, volume.geometry), file)
    for side in ("inside", "outside"):
        clicks = read_clicks([f"stroke:{file}"], side, volume)
        assert voxels(clicks) == {(1, 2, 3), (1, 2, 4)} and voxels(clicks, "outside") == {
            (8, 9, 10)
        }
    labels[8, 9, 10] = 0
    io.write(Volume(labels, volume.geometry), file)
    with pytest.raises(InputError, match="outside stroke.*no voxel has its label"):
        read_clicks([f"stroke:{file}"], "outside", volume)
    labels[0, 0, 0] = 3
    io.write(Volume(labels, volume.geometry), file)
    with pytest.raises(
        InputError, match=r"label 3 was given, expected 1 \(inside\), 2 \(outside\)"
    ):
        read_clicks([f"stroke:{file}"], "inside", volume)
    io.write(Volume.from_array(labels[:5], SPACING), file)
    with pytest.raises(GeometryError, match="on another grid"):
        read_clicks([f"stroke:{file}"], "inside", volume)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("point:900,1,1", InputError, "inside 'point:900,1,1': 900,1,1 lies outside of the volume"),
        ("point:-1,1,1vox", InputError, "lies outside of the volume"),
        ("point:1,2", UsageError, "3 numbers separated by commas"),
        ("point:1,2,nan", UsageError, "3 numbers separated by commas"),
        ("ball:900,1,1,3", InputError, "inside 'ball:900,1,1,3': no voxel centre is inside it"),
        ("blob:1,2,3", UsageError, "inside 'blob:1,2,3': unknown kind"),
        ("clicks", UsageError, "there is no click inside"),
        ("stroke:", UsageError, "no file named"),
        ("path:1,2,3", UsageError, "x, y, z and a radius for each place expected"),
        ("path:1,2,3,-1", UsageError, "x, y, z and a radius for each place expected"),
        ("path:1,2,3,1;nan,1,1,1", UsageError, "x, y, z and a radius for each place expected"),
        ("path:900,1,1,2;950,1,1,2", InputError, "no voxel is in it"),
        ("path:" + "1,2,3,4;" * 20_000, UsageError, "a path: 160005 characters, at most"),
        ("stroke:none.csv", InputError, "none.csv"),
        ("label:none.nii", InputError, "none.nii"),
    ],
)
def test_what_is_no_click_is_refused(volume, text, error, message):
    with pytest.raises(error, match=message.replace("(", r"\(")):
        read_clicks([text], "inside", volume)


def test_a_path_is_all_voxels_near_its_line(volume):
    """Against the distance to the line, voxel by voxel, with a radius that changes along it."""
    text = "path:3,5,9,1;9,12,18,2.5;9,4,18,2.5"
    (click,) = read_clicks([text], "inside", volume)
    index = np.indices((10, 20, 30)).reshape(3, -1).T * np.array(SPACING)
    ends = np.array([[9, 5, 3], [18, 12, 9], [18, 4, 9]], float)
    want = np.zeros(len(index), bool)
    for (a, b), (r, s) in zip(
        zip(ends, ends[1:], strict=False), ((1, 2.5), (2.5, 2.5)), strict=True
    ):
        share = np.clip((index - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        want |= (
            np.linalg.norm(index - a - share[:, None] * (b - a), axis=1)
            < r + share * (s - r) + 1e-6
        )
    got = Clicks((click,), (10, 20, 30)).mask("inside").ravel()
    assert got[want].all() and want.sum() > 100
    extra = index[got & ~want]  # what the line passes where it is thinner than the voxels are thick
    assert len(extra) < 0.1 * want.sum()
    assert voxels(read_clicks(["path:6,8,12,2.5"], "inside", volume)) == voxels(
        read_clicks(["ball:6,8,12,2.5"], "inside", volume)
    )


def test_a_path_without_a_width_is_a_line_of_voxels(volume):
    (click,) = read_clicks(["path:3,5,4,0;20,5,4,0vox"], "outside", volume)
    assert voxels([click], "outside") == {(4, 5, x) for x in range(3, 21)}
    # Beyond the volume it is cut off.
    assert voxels(read_clicks(["path:28,5,4,0;90,5,4,0vox"], "inside", volume)) == {
        (4, 5, 28),
        (4, 5, 29),
    }


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a,b,c\n1,2,3\n", "a,b,c was given as the first line"),
        ("x,y,z\n", "it has no row"),
        ("x,y,z\n1,2\n", "line 2: 1,2 was given, expected three numbers"),
        ("x,y,z,r\n1,2,3,-1\n", "no radius below 0"),
        ("x,y,z,side\n1,2,3,left\n", "side left was given, expected inside or outside"),
        ("x,y,z\n1,2,300\n", "lies outside of the volume"),
    ],
)
def test_damaged_strokes_are_refused(volume, tmp_path, content, message):
    file = tmp_path / "stroke.csv"
    file.write_text(content)
    with pytest.raises(InputError, match=message):
        read_clicks([f"stroke:{file}"], "inside", volume)


def test_a_voxel_on_both_sides_is_named(volume):
    clicks = read_clicks(["ball:6,8,12,2"], "inside", volume) + read_clicks(
        ["point:6,8,12"], "outside", volume
    )
    with pytest.raises(
        InputError,
        match=r"voxel 12,8,4 \(x,y,z; 6\.0,8\.0,12\.0 mm\) is clicked both inside and outside\n",
    ):
        check_contradictions(Clicks(tuple(clicks), volume.array.shape), volume.geometry)
    two = read_clicks(["point:6,8,12"], "inside", volume, id=3) + read_clicks(
        ["point:6,8,12"], "inside", volume, id=5
    )
    with pytest.raises(InputError, match="of object 3\n"):
        check_contradictions(Clicks(tuple(two), volume.array.shape), volume.geometry)
    fine = [two[0], *read_clicks(["point:6,8,12"], "outside", volume, id=5)]
    check_contradictions(Clicks(tuple(fine), volume.array.shape), volume.geometry)


def table(tmp_path, content):
    file = tmp_path / "objects.csv"
    file.write_text(content)
    return str(file)


def test_a_table_of_objects_with_sides(volume, tmp_path):
    rows = "2,5,5,5,,inside\n2,9,5,5,,outside\n0,1,1,1,2,inside\n7,20,9,4,2,inside\n"
    content = f"id,x_vox,y_vox,z_vox,r_vox,side\n{rows}"
    clicks = read_object_clicks(table(tmp_path, content), volume.geometry)
    assert clicks.ids() == (0, 2, 7)
    assert voxels(clicks.clicks, "inside", 2) == {(5, 5, 5)} and voxels(
        clicks.clicks, "outside", 2
    ) == {(5, 5, 9)}
    starts = starts_of(clicks, volume.geometry, 2)
    assert [one.id for one in starts] == [0, 2, 7]
    assert (
        int((starts[1].psi < 0).sum()) == 1
        and starts[1].psi.shape == (5, 5, 5)
        and starts[1].corner == (3, 3, 3)
    )
    assert read_object_clicks(table(tmp_path, "id,x,y,z,r\n1,5,5,5,2\n"), volume.geometry) is None
    assert read_object_clicks(np.ones((10, 20, 30), int), volume.geometry) is None


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,5,5,5,inside", "no row is inside an object"),
        ("0,5,5,5,outside", "id 0 is no object"),
        ("1,5,5,5,inside\n2,9,9,9,outside", "id 2 has no row inside"),
        ("1.5,5,5,5,inside", "id 1.5 was given, expected a whole number from 0 on"),
        (",5,5,5,inside", "expected a whole number from 0 on"),
        ("1,5,5,5,above", "side above was given"),
        ("1,5,5,500,inside", "lies outside of the volume"),
        ("1,5,5,5,inside\n2,5,5,5,inside", "is clicked both inside and outside of object 1"),
    ],
)
def test_tables_that_say_nothing_are_refused(volume, tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        read_object_clicks(table(tmp_path, f"id,x,y,z,side\n{rows}\n"), volume.geometry)
