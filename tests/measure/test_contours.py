"""Contours of images of one slice: where they lie, which way they run, their measures and files."""

import csv

import numpy as np
import pytest
import pyvista

from accelsurf.errors import EmptyResultError, InputError, OutputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.contours import Contours, extract_contours, in_slices
from accelsurf.measure.surface_mesh import extract_surface as extract_surface

GRID = Geometry((1, 40, 50), (7.0, 1.0, 0.5))


def disc(geometry=GRID, centre=(20.0, 12.0), radius=8.0):
    """Signed distance (mm) to a circle; centre (v, u) mm from the first pixel along the two axes."""
    v, u = (
        np.arange(n) * h
        for n, h in zip(np.squeeze(np.empty(geometry.shape)).shape, geometry.steps, strict=True)
    )
    psi = np.hypot(v[:, None] - centre[0], u[None, :] - centre[1]) - radius
    return np.expand_dims(psi, geometry.slice_axis).astype(np.float32)


def screen_area(loop):
    """Twice the signed area, negative for a loop that runs counter-clockwise on the screen, where y runs down."""
    x, y, _ = loop.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def test_circle():
    contours = extract_contours(disc(), GRID)
    (loop,) = contours.loops
    assert np.abs(np.hypot(loop[:, 0] - 12.0, loop[:, 1] - 20.0) - 8.0).max() < 0.02
    assert (loop[:, 2] == 0).all()
    assert contours.length == pytest.approx(2 * np.pi * 8, rel=2e-3)
    assert contours.area == pytest.approx(np.pi * 64, rel=3e-3)


def test_the_object_lies_to_the_left_on_the_screen():
    ring = np.maximum(disc(), -disc(radius=3.0))
    contours = extract_contours(ring, GRID)
    assert sorted(np.sign([screen_area(loop) for loop in contours.loops])) == [-1, 1]
    outer = min(contours.loops, key=screen_area)
    assert abs(screen_area(outer)) > 100  # the outer one runs counter-clockwise, the hole clockwise
    assert contours.area == pytest.approx(np.pi * (64 - 9), rel=5e-3)
    assert contours.length == pytest.approx(2 * np.pi * 11, rel=5e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_any_axis_may_be_missing_and_the_grid_may_be_oblique(axis):
    rng = np.random.default_rng(axis)
    direction, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    shape, spacing = [40, 50], [1.0, 0.5]
    shape.insert(axis, 1)
    spacing.insert(axis, 3.0)
    geometry = Geometry(tuple(shape), tuple(spacing), (500.0, -900.0, 100.0), direction)
    contours = extract_contours(disc(geometry), geometry)
    assert contours.area == pytest.approx(np.pi * 64, rel=3e-3)
    index = geometry.world_to_index(contours.loops[0])
    assert np.abs(index[:, axis]).max() < 1e-9
    v, u = (index[:, a] * spacing[a] for a in range(3) if a != axis)
    assert np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v) < 0


@pytest.mark.parametrize("centre", [(20.0, 0.0), (0.0, 0.0), (39.0, 24.5), (20.0, 12.0)])
def test_border_the_contour_agrees_with_the_prism_of_the_mesh(centre):
    psi = disc(centre=centre, radius=9.3)
    contours, prism = extract_contours(psi, GRID), extract_surface(psi, GRID)
    assert contours.area * 7.0 == pytest.approx(prism.volume, rel=1e-5)
    # The displacements are averaged over triangles there, over segments here, which differ where the curve ends.
    assert contours.length * 7.0 == pytest.approx(prism.area - 2 * contours.area, rel=5e-5)
    index = GRID.world_to_index(np.concatenate(contours.loops))
    assert (index[:, 1:] >= -0.5).all() and (index[:, 1:] <= (39.5, 49.5)).all()


def test_full_image_is_its_rectangle():
    contours = extract_contours(np.full((1, 40, 50), -1.0, np.float32), GRID)
    assert (contours.area, contours.length) == pytest.approx((40 * 25, 2 * (40 + 25)))


def test_one_pixel_and_corners_that_touch():
    psi = np.full((1, 40, 50), 0.4, np.float32)
    psi[0, 5, 5] = psi[0, 6, 6] = psi[0, 0, 49] = -0.4
    contours = extract_contours(psi, GRID)
    assert len(contours.loops) == 3
    assert all(
        len(loop) >= 3 and (loop != np.roll(loop, 1, axis=0)).any(axis=1).all()
        for loop in contours.loops
    )


def test_psi_of_exactly_zero_is_outside():
    psi = np.full((1, 40, 50), 5.0, np.float32)
    psi[0, 10:21, 10:21] = 0.0
    psi[0, 11:20, 11:20] = -0.5
    # So deep, and so far from all else, that it is no small part.
    psi[0, 12:19, 12:19] = -5.0
    contours = extract_contours(psi, GRID)
    # 9 x 9 pixels inside, each reaching its neighbours' centres: 10 x 5 mm without the corners
    assert len(contours.loops) == 1 and contours.area == pytest.approx(
        10.0 * 5.0 - 4 * 0.25, rel=1e-3
    )


def test_what_is_no_contour():
    with pytest.raises(EmptyResultError, match="no pixel"):
        extract_contours(np.ones((1, 40, 50), np.float32), GRID)
    with pytest.raises(InputError, match="one slice expected"):
        extract_contours(np.ones((2, 40, 50), np.float32), Geometry((2, 40, 50), (1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="NaN"):
        extract_contours(np.full((1, 40, 50), np.nan, np.float32), GRID)


# ------------------------------------------------------------------------------------------------------- files


@pytest.fixture
def ring():
    return extract_contours(np.maximum(disc(), -disc(radius=3.0)), GRID)


def test_vtp_has_closed_polylines(ring, tmp_path):
    ring.write(tmp_path / "a.vtp")
    mesh = pyvista.read(tmp_path / "a.vtp")
    assert mesh.n_lines == 2 and mesh.n_points == sum(map(len, ring.loops))
    np.testing.assert_array_equal(mesh.points, np.concatenate(ring.loops))
    assert mesh.compute_cell_sizes()["Length"].sum() == pytest.approx(ring.length)
    assert [mesh.get_cell(i).point_ids[0] == mesh.get_cell(i).point_ids[-1] for i in (0, 1)] == [
        True,
        True,
    ]
    assert (mesh.field_data["SPACE"][0], mesh.field_data["UNIT"][0]) == ("LPS", "mm")


def test_csv_has_a_row_for_each_point_and_closes(ring, tmp_path):
    ring.write(tmp_path / "a.csv")
    ring.write(tmp_path / "ras.csv", "ras")
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert list(rows[0]) == ["contour", "x_lps_mm", "y_lps_mm", "z_lps_mm"]
    for number, loop in enumerate(ring.loops):
        points = [
            [float(row[f"{a}_lps_mm"]) for a in "xyz"]
            for row in rows
            if row["contour"] == str(number)
        ]
        np.testing.assert_allclose(points, np.vstack([loop, loop[:1]]), atol=1e-6)
    first = next(csv.DictReader((tmp_path / "ras.csv").read_text().splitlines()))
    assert float(first["x_ras_mm"]) == -float(rows[0]["x_lps_mm"])
    assert float(first["y_ras_mm"]) == -float(rows[0]["y_lps_mm"])
    assert float(first["z_ras_mm"]) == float(rows[0]["z_lps_mm"])


def test_files_are_whole_or_not_there(ring, tmp_path):
    for name, options, words in (
        ("a.ply", (), "contour format '.ply'"),
        ("a.csv", ("xyz",), "space 'xyz'"),
    ):
        with pytest.raises(UsageError, match=words):
            ring.write(tmp_path / name, *options)
    with pytest.raises(OutputError):
        ring.write(tmp_path / "none" / "a.csv")
    assert not list(tmp_path.iterdir())
    ring.write(tmp_path / "A.CSV")
    ring.write(tmp_path / "b.csv")
    assert (tmp_path / "A.CSV").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_measures_far_from_the_origin():
    square = np.array([[0.0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]]) + 1e7
    assert Contours((square,)).area == pytest.approx(1.0, abs=1e-9)


# ---------------------------------------------------------------------------------------- contours of a volume's slices


def ball(geometry, centre, radius):
    """Signed distance (mm) to a ball around a world position."""
    places = geometry.index_to_world(np.moveaxis(np.indices(geometry.shape), 0, -1))
    return (np.linalg.norm(places - centre, axis=-1) - radius).astype(np.float32)


@pytest.mark.parametrize("oblique", [False, True])
def test_slices_of_a_ball(oblique):
    turned, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    geometry = Geometry(
        (20, 40, 44), (2.0, 0.8, 0.7), (100.0, -50.0, 30.0), turned if oblique else np.eye(3)
    )
    centre = geometry.index_to_world((9.3, 19.6, 21.2))
    found = in_slices(ball(geometry, centre, 12.0), geometry)
    heights = (np.arange(20) - 9.3) * 2.0
    assert sorted(found) == np.flatnonzero(np.abs(heights) < 12.0).tolist()
    for k, contours in found.items():
        radius = np.sqrt(12.0**2 - heights[k] ** 2)
        (loop,) = contours.loops
        assert np.abs(geometry.world_to_index(loop)[:, 0] - k).max() < 1e-9
        centre_here = geometry.index_to_world((k, 19.6, 21.2))
        # psi of the ball along a slice: no further from the circle than a thirtieth of a pixel.
        assert np.abs(np.linalg.norm(loop - centre_here, axis=1) - radius).max() < 0.02
        assert contours.area == pytest.approx(np.pi * radius**2, rel=3e-4)


def test_slices_with_a_hole_and_an_island_in_it():
    geometry = Geometry((5, 60, 60), (2.0, 0.5, 0.5))
    place = geometry.index_to_world(np.moveaxis(np.indices(geometry.shape), 0, -1))
    distance = np.hypot(place[..., 0] - 15, place[..., 1] - 14)
    psi = np.minimum(np.maximum(distance - 12, 7 - distance), distance - 3)
    psi = np.maximum(psi, np.abs(place[..., 2] - 4) - 3).astype(np.float32)
    found = in_slices(psi, geometry)
    assert sorted(found) == [1, 2, 3]
    assert len(found[2].loops) == 3
    assert found[2].area == pytest.approx(np.pi * (144 - 49 + 9), rel=3e-3)


def test_slices_of_an_object_that_the_border_cuts():
    geometry = Geometry((6, 20, 30), (3.0, 0.8, 0.7))
    found = in_slices(ball(geometry, (0.0, 0.0, 0.0), 9.5), geometry)
    assert sorted(found) == [0, 1, 2, 3]
    # A quarter of the disc, and the half pixels up to the border.
    assert found[0].area == pytest.approx(
        np.pi * 9.5**2 / 4 + 9.5 * (0.4 + 0.35) + 0.4 * 0.35, rel=2e-3
    )
    index = geometry.world_to_index(np.concatenate(found[0].loops))
    assert index[:, 1:].min() == pytest.approx(-0.5)


def test_slices_agree_with_the_image_of_one_slice():
    volume = Geometry((1, 40, 50), (7.0, 1.0, 0.5))
    (loop,) = in_slices(disc(), volume)[0].loops
    assert np.abs(loop - extract_contours(disc(), GRID).loops[0]).max() < 1e-9


def test_slices_of_an_empty_volume_and_of_another_grid():
    geometry = Geometry((3, 4, 5), (1.0, 1.0, 1.0))
    assert in_slices(np.ones((3, 4, 5), np.float32), geometry) == {}
    with pytest.raises(InputError, match="shape"):
        in_slices(np.ones((3, 5, 4), np.float32), geometry)
