from xml.etree import ElementTree

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import OutputError
from accelsurf.track.output import geff_file, outputs, trackmate_file
from accelsurf.track.output.frames import FrameStore, TrackSet
from accelsurf.track.output.trackmate_file import spots_of
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
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 1 0\n2 0 2 0\n3 3 4 2\n4 3 4 2\n5 3 4 1\n"
    for number, ids in enumerate(({1: 1, 2: 2}, {1: 1, 2: 2}, {2: 2}, {1: 5, 3: 3, 4: 4}, {1: 5, 3: 3, 4: 4})):
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
    made.results[1].objects[0].surface.psi[...] = 1.0  # shrunk between the voxels, and still tracked
    outputs.write_challenge(set_of(made, tmp_path), tmp_path / "RES")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 0 0\n2 2 2 1\n"


def test_spots_are_linked_over_gaps_and_divisions(cells):
    graph = spots_of(cells)
    named = [(spot.row.frame, spot.tracked.id) for spot in graph.spots]
    assert named == [(0, 1), (0, 2), (1, 1), (1, 2), (2, 2), (3, 1), (3, 3), (3, 4), (4, 1), (4, 3), (4, 4)]
    assert {(named[a], named[b]): kind for a, b, kind in graph.links} == {
        ((0, 1), (1, 1)): "motion", ((1, 1), (3, 1)): "motion", ((3, 1), (4, 1)): "motion",
        ((0, 2), (1, 2)): "motion", ((1, 2), (2, 2)): "motion", ((2, 2), (3, 3)): "division",
        ((2, 2), (3, 4)): "division", ((3, 3), (4, 3)): "motion", ((3, 4), (4, 4)): "motion",
    }  # fmt: skip
    assert graph.components() == [(0, 2, 5, 8), (1, 3, 4, 6, 7, 9, 10)]


def test_a_child_without_a_parent_that_was_seen_has_no_link(cells):
    lost = TrackSet("cells", cells.sequence, cells.rows[3:], cells.lineage, cells.store)
    assert all(link.kind == "motion" for link in spots_of(lost).links)


def test_trackmate_has_spots_along_the_grid_and_an_edge_for_each_link(cells, tmp_path):
    trackmate_file.write_trackmate(cells, tmp_path / "cells.xml")
    root = ElementTree.parse(tmp_path / "cells.xml").getroot()
    spots = {int(spot.get("ID")): spot for spot in root.iter("Spot")}
    assert root.find("Model").attrib == {"spatialunits": "mm", "timeunits": "s"}
    assert root.find("Model/AllSpots").get("nspots") == str(len(spots)) == "11"
    spot = spots[5]  # object 1 in frame 3: voxel (4, 5, 11) of 2 x 1 x 1 mm
    assert [float(spot.get(f"POSITION_{axis}")) for axis in "XYZT"] == [11.0, 5.0, 8.0, 1.5]
    assert [float(spot.get(f"WORLD_{axis}")) for axis in "XYZ"] == [16.0, 2.0, 18.0]
    assert float(spot.get("RADIUS")) == pytest.approx(3.5)
    declared = {feature.get("feature") for feature in root.find("Model/FeatureDeclarations/SpotFeatures")}
    assert set(spot.attrib) == declared | {"ID", "name"}
    tracks = root.findall("Model/AllTracks/Track")
    edges = [[(int(e.get("SPOT_SOURCE_ID")), int(e.get("SPOT_TARGET_ID"))) for e in track] for track in tracks]
    assert edges == [[(0, 2), (2, 5), (5, 8)], [(1, 3), (3, 4), (4, 6), (4, 7), (6, 9), (7, 10)]]
    counts = [[int(track.get(f"NUMBER_{what}")) for what in ("SPOTS", "GAPS", "SPLITS", "MERGES")] for track in tracks]
    assert counts == [[4, 1, 0, 0], [7, 0, 1, 0]]
    assert [one.get("TRACK_ID") for one in root.find("Model/FilteredTracks")] == ["0", "1"]
    image = root.find("Settings/ImageData").attrib
    assert [image[key] for key in ("width", "height", "nslices", "nframes")] == ["24", "20", "10", "5"]
    assert [float(image[key]) for key in ("pixelwidth", "voxeldepth", "timeinterval")] == [1.0, 2.0, 0.5]


def test_trackmate_of_one_slice_has_radii_of_discs_and_mergers(flat, tmp_path):
    trackmate_file.write_trackmate(flat, tmp_path / "flat.xml")
    root = ElementTree.parse(tmp_path / "flat.xml").getroot()
    assert [float(spot.get("RADIUS")) for spot in root.iter("Spot")] == pytest.approx([2.0] * 6 + [2.8])
    (track,) = root.findall("Model/AllTracks/Track")
    assert (track.get("NUMBER_SPLITS"), track.get("NUMBER_MERGES")) == ("0", "1")


def test_geff_has_nodes_edges_and_what_is_known_of_them(cells, tmp_path):
    import zarr

    geff_file.write_geff(cells, tmp_path / "cells.geff")
    root = zarr.open_group(tmp_path / "cells.geff", mode="r")
    about = root.attrs["geff"]
    assert (about["directed"], [axis["name"] for axis in about["axes"]]) == (True, ["t", "z", "y", "x"])
    assert (about["axes"][0]["scale"], about["axes"][0]["scaled_unit"]) == (0.5, "second")
    np.testing.assert_array_equal(root["nodes/ids"][:], np.arange(11))
    np.testing.assert_array_equal(root["edges/ids"][:][:4], [[0, 2], [1, 3], [2, 5], [3, 4]])
    np.testing.assert_array_equal(root["nodes/props/id/values"][:], [1, 2, 1, 2, 2, 1, 3, 4, 1, 3, 4])
    np.testing.assert_array_equal(root["nodes/props/t/values"][:], [0, 0, 1, 1, 2, 3, 3, 3, 4, 4, 4])
    place = [float(root[f"nodes/props/{axis}/values"][5]) for axis in "xyz"]
    assert place == [16.0, 2.0, 18.0]
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
    links = spots_of(set_of(made(), tmp_path)).links
    assert sorted(graph.edges) == [(link.source, link.target) for link in links]
    assert about.sphere == "radius"


def test_tracks_of_no_object_can_be_written(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{}, {}])
    empty = set_of(made, tmp_path)
    empty = TrackSet("none", empty.sequence, empty.rows, Lineage((), ()), empty.store)
    outputs.write_challenge(empty, tmp_path / "RES")
    trackmate_file.write_trackmate(empty, tmp_path / "none.xml")
    geff_file.write_geff(empty, tmp_path / "none.geff")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == ""
    assert ElementTree.parse(tmp_path / "none.xml").getroot().find("Model/AllSpots").get("nspots") == "0"


def test_a_track_that_is_never_seen_has_no_line(tmp_path):
    made = tracking(flat_cells().sequence.geometry, [{1: Ball((0.0, 12.0, 12.0), 2.0)}])
    more = Lineage((*made.lineage.tracks, Track(2, 0, 0, (), "vanished")), ())
    outputs.write_challenge(set_of(made._replace(lineage=more), tmp_path), tmp_path / "RES")
    assert (tmp_path / "RES" / "res_track.txt").read_text() == "1 0 0 0\n"
