import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import OutputError
from accelsurf.track.output import geff_file, outputs
from accelsurf.track.output.frames import FrameStore, TrackSet
from accelsurf.track.output.geff_file import links_of, spots_of
from accelsurf.track.records import Lineage, Track
from tests.support.trackings import Ball, dividing_cells, flat_cells, tracking


def set_of(made, folder) -> TrackSet:
    store = FrameStore(folder / "frames")
    for result in made.results:
        store.put(result)
    rows = tuple(store.frame_row(number) for number in store.numbers())
    return TrackSet("cells", made.sequence, rows, made.lineage, store)


@pytest.fixture
def cells(tmp_path):
    return set_of(dividing_cells(), tmp_path)


@pytest.fixture
def flat(tmp_path):
    return set_of(flat_cells(), tmp_path)


def test_challenge_has_a_new_track_after_a_gap_and_the_parents_of_a_division(cells, tmp_path):
    outputs.write_challenge(cells, tmp_path / "RES")
    assert (
        tmp_path / "RES" / "res_track.txt"
    ).read_text() == "1 0 1 0\n2 0 2 0\n3 3 4 2\n4 3 4 2\n5 3 4 1\n"
    for number, ids in enumerate(
        ({1: 1, 2: 2}, {1: 1, 2: 2}, {2: 2}, {1: 5, 3: 3, 4: 4}, {1: 5, 3: 3, 4: 4})
    ):
        found = io.read(tmp_path / "RES" / f"mask{number:03d}.tif").array
        labels = cells.labels(number)
        assert found.dtype == np.uint16
        assert set(np.unique(labels)) == {0, *ids}
        expected = np.zeros_like(found)
        for own, label in ids.items():
            expected[labels == own] = label
        np.testing.assert_array_equal(found, expected)


def test_challenge_has_one_parent_of_several(flat, tmp_path):
    outputs.write_challenge(flat, tmp_path / "RES")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 2 0\n2 0 2 0\n3 3 3 1\n"


def test_challenge_refuses_labels_beyond_16_bits(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{70000: Ball((0.0, 12.0, 12.0), 2.0)}])
    with pytest.raises(OutputError, match="label 70000"):
        outputs.write_challenge(set_of(made, tmp_path), tmp_path / "RES")
    assert not (tmp_path / "RES").exists()


def test_an_object_without_a_voxel_is_in_no_frame_of_the_challenge(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{1: Ball((0.0, 12.0, 12.0), 2.0)}] * 3)
    made.results[1].objects[0].surface.psi[...] = (
        1.0  # shrunk between the voxels, and still tracked
    )
    outputs.write_challenge(set_of(made, tmp_path), tmp_path / "RES")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 0 0\n2 2 2 1\n"


def test_spots_are_linked_over_gaps_and_divisions(cells):
    spots = spots_of(cells)
    named = [(spot.row.frame, spot.tracked.id) for spot in spots]
    assert named == [
        (0, 1),
        (0, 2),
        (1, 1),
        (1, 2),
        (2, 2),
        (3, 1),
        (3, 3),
        (3, 4),
        (4, 1),
        (4, 3),
        (4, 4),
    ]
    assert {(named[a], named[b]): kind for a, b, kind in links_of(cells, spots)} == {
        ((0, 1), (1, 1)): "motion",
        ((1, 1), (3, 1)): "motion",
        ((3, 1), (4, 1)): "motion",
        ((0, 2), (1, 2)): "motion",
        ((1, 2), (2, 2)): "motion",
        ((2, 2), (3, 3)): "division",
        ((2, 2), (3, 4)): "division",
        ((3, 3), (4, 3)): "motion",
        ((3, 4), (4, 4)): "motion",
    }


def test_a_child_without_a_parent_that_was_seen_has_no_link(cells):
    lost = TrackSet("cells", cells.sequence, cells.rows[3:], cells.lineage, cells.store)
    assert all(link.kind == "motion" for link in links_of(lost, spots_of(lost)))


def test_geff_has_nodes_edges_and_what_is_known_of_them(cells, tmp_path):
    import zarr

    geff_file.write_geff(cells, tmp_path / "cells.geff")
    root = zarr.open_group(tmp_path / "cells.geff", mode="r")
    about = root.attrs["geff"]
    assert (about["directed"], [axis["name"] for axis in about["axes"]]) == (
        True,
        ["t", "z", "y", "x"],
    )
    assert (about["axes"][0]["scale"], about["axes"][0]["scaled_unit"]) == (0.5, "second")
    np.testing.assert_array_equal(root["nodes/ids"][:], np.arange(11))
    np.testing.assert_array_equal(root["edges/ids"][:][:4], [[0, 2], [1, 3], [2, 5], [3, 4]])
    np.testing.assert_array_equal(
        root["nodes/props/id/values"][:], [1, 2, 1, 2, 2, 1, 3, 4, 1, 3, 4]
    )
    np.testing.assert_array_equal(
        root["nodes/props/t/values"][:], [0, 0, 1, 1, 2, 3, 3, 3, 4, 4, 4]
    )
    place = [float(root[f"nodes/props/{axis}/values"][5]) for axis in "xyz"]
    assert place == [16.0, 2.0, 18.0]
    assert root["nodes/props/lineage/values"][:].tolist() == [0, 1, 0, 1, 1, 0, 1, 1, 0, 1, 1]
    np.testing.assert_allclose(root["nodes/props/radius/values"][5], 3.5, rtol=1e-6)
    division = root["edges/props/division/values"][:]
    assert root["edges/ids"][:][division].tolist() == [[4, 6], [4, 7]]
    for kind in ("node", "edge"):
        assert set(about[f"{kind}_props_metadata"]) == set(root[f"{kind}s/props"].group_keys())


@pytest.mark.parametrize("made", [dividing_cells, flat_cells])
def test_geff_is_valid_by_its_own_library(made, tmp_path):
    geff = pytest.importorskip("geff")
    geff_file.write_geff(set_of(made(), tmp_path), tmp_path / "cells.geff")
    geff.validate_structure(tmp_path / "cells.geff")
    graph, about = geff.read(tmp_path / "cells.geff")
    tracks = set_of(made(), tmp_path)
    links = links_of(tracks, spots_of(tracks))
    assert sorted(graph.edges) == [(link.source, link.target) for link in links]
    assert about.sphere == "radius"


def test_tracks_of_no_object_can_be_written(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{}, {}])
    empty = set_of(made, tmp_path)
    empty = TrackSet("none", empty.sequence, empty.rows, Lineage((), ()), empty.store)
    outputs.write_challenge(empty, tmp_path / "RES")
    geff_file.write_geff(empty, tmp_path / "none.geff")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == ""


def test_a_track_that_is_never_seen_has_no_line(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{1: Ball((0.0, 12.0, 12.0), 2.0)}])
    more = Lineage((*made.lineage.tracks, Track(2, 0, 0, (), "vanished")), ())
    outputs.write_challenge(set_of(made._replace(lineage=more), tmp_path), tmp_path / "RES")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 0 0\n"
