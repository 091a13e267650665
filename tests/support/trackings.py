"""Trackings with a known outcome: balls on exact paths, as the loop over frames would yield them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.grid.boxes import bounding_box, corner_of, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.track.records import FrameResult, Lineage, Link, SurfacePiece, Track, TrackedObject


class Ball(NamedTuple):
    """A ball in a frame: its center (z, y, x) in voxels, its radius in mm, and whether the frame shows it."""

    center: tuple[float, float, float]
    radius: float
    seen: bool = True


class Tracking(NamedTuple):
    sequence: VolumeSequence
    results: tuple[FrameResult, ...]
    lineage: Lineage


def piece_of(ball: Ball, geometry: Geometry) -> SurfacePiece:
    places = [
        (np.arange(n) - c) * h
        for n, c, h in zip(geometry.shape, ball.center, geometry.spacing, strict=True)
    ]
    if geometry.slice_axis is not None:
        places[geometry.slice_axis] = np.zeros(1)
    z, y, x = np.meshgrid(*places, indexing="ij")
    psi = (np.sqrt(z**2 + y**2 + x**2) - ball.radius).astype(np.float32)
    box = widened(bounding_box(psi < 0), geometry.shape, (3, 3, 3))
    return SurfacePiece(corner_of(box), psi[box].copy())


def object_of(
    own: int, ball: Ball, geometry: Geometry, before: Ball | None = None
) -> TrackedObject:
    is_2d = geometry.slice_axis is not None
    thick = geometry.spacing[geometry.slice_axis] if is_2d else 0.0
    volume = math.pi * ball.radius**2 * thick if is_2d else 4 / 3 * math.pi * ball.radius**3
    area = 2 * math.pi * ball.radius * thick if is_2d else 4 * math.pi * ball.radius**2
    centroid = tuple(float(v) for v in geometry.index_to_world(ball.center))
    velocity = (0.0, 0.0, 0.0)
    if before is not None:
        velocity = tuple(
            b - a for a, b in zip(geometry.index_to_world(before.center), centroid, strict=True)
        )
    predicted = None if before is None else piece_of(before, geometry)
    quality = 0.9 if ball.seen else 0.0
    piece = piece_of(ball, geometry)
    return TrackedObject(
        own, piece, predicted, velocity, volume, area, centroid, ball.seen, quality
    )


def tracking(
    geometry: Geometry,
    frames: Sequence[Mapping[int, Ball]],
    links: Sequence[Link] = (),
    times: Sequence[float] | None = None,
) -> Tracking:
    """Frames of balls by id, their images (1 inside, 0 outside), and the lineage that belongs to them."""
    volumes, objects = [], []
    for number, balls in enumerate(frames):
        before = frames[number - 1] if number else {}
        found = tuple(
            object_of(own, ball, geometry, before.get(own)) for own, ball in sorted(balls.items())
        )
        image = np.zeros(geometry.shape, np.float32)
        for one in found:
            if one.seen:
                image[one.surface.box][one.surface.psi < 0] = 1.0
        volumes.append(Volume(image, geometry))
        objects.append(found)
    sequence = VolumeSequence(volumes, times)
    results = tuple(
        FrameResult(number, sequence.times[number], volume, found)
        for number, (volume, found) in enumerate(zip(volumes, objects, strict=True))
    )
    return Tracking(sequence, results, lineage_of(frames, links))


def lineage_of(frames: Sequence[Mapping[int, Ball]], links: Sequence[Link]) -> Lineage:
    tracks = []
    for own in sorted({own for balls in frames for own in balls}):
        seen = [number for number, balls in enumerate(frames) if own in balls and balls[own].seen]
        gaps = tuple(number for number in range(seen[0], seen[-1]) if number not in seen)
        end = "divided" if any(link.parent == own for link in links) else "end of sequence"
        tracks.append(Track(own, seen[0], seen[-1], gaps, end))
    return Lineage(tuple(tracks), tuple(links))


def dividing_cells() -> Tracking:
    """Object 1 moves and is not seen in frame 2; object 2 divides into 3 and 4 in frame 3. Voxels of 2 x 1 x 1 mm."""
    geometry = Geometry((10, 20, 24), (2.0, 1.0, 1.0), (5.0, -3.0, 10.0))
    frames: list[dict[int, Ball]] = []
    for number in range(5):
        balls = {1: Ball((4.0, 5.0, 5.0 + 2 * number), 3.5, seen=number != 2)}
        if number < 3:
            balls[2] = Ball((5.0, 14.0, 12.0), 4.0)
        else:
            balls |= {
                3: Ball((5.0, 14.0, 12.0 - 2 * number), 2.5),
                4: Ball((5.0, 14.0, 12.0 + 2 * number), 2.5),
            }
        frames.append(balls)
    links = [Link(2, 3, 3, "division"), Link(2, 4, 3, "division")]
    return tracking(geometry, frames, links, [0.0, 0.5, 1.0, 1.5, 2.0])


def flat_cells() -> Tracking:
    """The same idea in one slice, pixels of .5 mm: 1 and 2 move towards each other and merge into 3 in frame 3."""
    geometry = Geometry((1, 24, 32), (1.0, 0.5, 0.5))
    frames: list[dict[int, Ball]] = []
    for number in range(4):
        if number < 3:
            frames.append(
                {
                    1: Ball((0.0, 12.0, 7.0 + 2 * number), 2.0),
                    2: Ball((0.0, 12.0, 25.0 - 2 * number), 2.0),
                }
            )
        else:
            frames.append({3: Ball((0.0, 12.0, 16.0), 2.8)})
    return tracking(geometry, frames, [Link(1, 3, 3, "merging"), Link(2, 3, 3, "merging")])
