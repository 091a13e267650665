"""Axes as displays show them, whatever the order of the grid."""

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import DisplayOrientation


def test_anatomical_axes_are_displayed_alike_whatever_the_order_of_the_grid():
    # Stored sagittally: index x runs to the back, index y to the feet, index z to the right.
    direction = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    geometry = Geometry((4, 5, 6), (3.0, 2.0, 1.0), (10.0, 20.0, 30.0), direction)
    display = DisplayOrientation.of(geometry)
    array = np.arange(4 * 5 * 6).reshape(4, 5, 6)
    reoriented = display.reorient(array)
    assert reoriented.shape == (5, 6, 4) and display.spacing == (2.0, 1.0, 3.0)
    for index in ((0, 0, 0), (4, 5, 3), (1, 2, 3)):
        place = np.argwhere(array == reoriented[index])[0]
        world = geometry.index_to_world(place)  # x, y, z
        assert [display.coordinate(axis, index[axis]) for axis in range(3)] == pytest.approx(
            list(world[::-1])
        )
    assert display.names == ("z", "y", "x")


def test_oblique_axes_are_marked_and_start_at_zero():
    c, s = np.cos(0.2), np.sin(0.2)
    turn = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    display = DisplayOrientation.of(Geometry((4, 5, 6), (1.0, 1.0, 1.0), (9.0, 9.0, 9.0), turn))
    assert display.names == ("z'", "y'", "x'") and display.coordinate(2, 0) == 0.0
