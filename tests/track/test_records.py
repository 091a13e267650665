"""Label maps of a frame, and lineages."""

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.track.records import FrameResult, Lineage, Link, SurfacePiece, TrackedObject


def tracked(
    number: int, corner: tuple[int, int, int], psi: np.ndarray, seen: bool = True
) -> TrackedObject:
    piece = SurfacePiece(corner, psi.astype(np.float32))
    return TrackedObject(number, piece, None, (0.0, 0.0, 0.0), 1.0, 1.0, (0.0, 0.0, 0.0), seen, 1.0)


def test_labels_are_ids_and_the_deeper_surface_has_the_voxel() -> None:
    geometry = Geometry((1, 1, 6), (1.0, 1.0, 1.0))
    image = Volume(np.zeros((1, 1, 6), np.float32), geometry)
    one = tracked(1, (0, 0, 0), np.array([[[-1.0, -2.0, -1.0, 0.5]]]))
    two = tracked(300, (0, 0, 2), np.array([[[-2.0, -1.0, -0.5, 1.0]]]))
    ghost = tracked(7, (0, 0, 5), np.array([[[-9.0]]]), seen=False)
    result = FrameResult(0, 0.0, image, (one, two, ghost))
    assert result.labels().ravel().tolist() == [1, 1, 300, 300, 300, 0]
    assert result.labels().dtype == np.uint16
    assert result.labels(seen_only=False).ravel().tolist() == [1, 1, 300, 300, 300, 7]


def test_parents_and_children_of_a_division_and_a_merging() -> None:
    lineage = Lineage(
        (),
        (
            Link(1, 2, 5, "division"),
            Link(1, 3, 5, "division"),
            Link(2, 4, 8, "merging"),
            Link(3, 4, 8, "merging"),
        ),
    )
    assert lineage.children(1) == (2, 3)
    assert lineage.parents(4) == (2, 3) and lineage.parents(1) == ()
