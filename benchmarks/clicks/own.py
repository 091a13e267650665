"""accelsurf as the benchmark drives it: clicks as a person types them, with everything else left to the program."""

from __future__ import annotations

from typing import Any

import numpy as np

from accelsurf.api.segment import segment
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from benchmarks.clicks.games import Segmenter
from benchmarks.clicks.person import Mask, PersonClick, ball_voxels


def segmenter(name: str) -> Segmenter:
    """Our methods by name."""
    return {"accelsurf": Refined, "accelsurf-rerun": Rerun, "accelsurf-start": StartAlone}[name]


def text_of(click: PersonClick, image: Volume) -> str:
    """A click as a person types it.

    Examples
    --------
    >>> image = Volume.from_array(np.zeros((9, 9, 9)), 1.0)
    >>> text_of(PersonClick("inside", (2, 3, 4), (4.0, 3.0, 2.0), 2.5), image)
    'ball:4.0,3.0,2.0,2.5'
    >>> text_of(PersonClick("inside", (2, 3, 4), (4.0, 3.0, 2.0), 0.5), image)
    'point:4.0,3.0,2.0'
    """
    place = ",".join(repr(value) for value in click.centre)
    one_voxel = click.radius <= 0.5 * min(image.geometry.spacing)
    return f"point:{place}" if one_voxel else f"ball:{place},{click.radius!r}"


class Rerun:
    """`accelsurf segment` with all clicks so far, from the beginning at every click."""

    def __init__(self, image: Volume, size_mm3: float | None) -> None:
        self.image = image
        self.options: dict[str, Any] = {} if size_mm3 is None else {"size": f"{size_mm3:.6f}mm3"}
        self.texts: dict[str, list[str]] = {"inside": [], "outside": []}

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        self.texts[click.side].append(text_of(click, self.image))
        given = {side: tuple(texts) for side, texts in self.texts.items()}
        return np.asarray(segment(self.image, config=RunConfig(**given, **self.options)).labels > 0)


class Refined:
    """`accelsurf segment` at the first click, `accelsurf refine` at every later one."""

    def __init__(self, image: Volume, size_mm3: float | None) -> None:
        self.image, self.size = image, size_mm3
        self.result: Any = None

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        from accelsurf.correct.refine import refine

        given: dict[str, Any] = {click.side: (text_of(click, self.image),)}
        if self.result is None:
            if self.size is not None:
                given["size"] = f"{self.size:.6f}mm3"
            self.result = segment(self.image, config=RunConfig(**given, keep_state="yes"))
        else:
            self.result = refine(self.result, **given)
        return np.asarray(self.result.labels > 0)


class StartAlone:
    """The seeded model's own start, which the surface would begin from."""

    def __init__(self, image: Volume, size_mm3: float | None) -> None:
        self.image, self.size = image, size_mm3
        self.clicks = Clicks((), image.geometry.shape)
        self.model: Any = None

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        from accelsurf.energies.seeded.model import seeded_model

        box, ball = ball_voxels(click, self.image.geometry)
        side: Any = click.side
        self.clicks = self.clicks.with_more([Click(side, box, ball)])
        values = self.image.as_float32()
        self.model = seeded_model(
            [values], self.image.geometry.spacing, self.clicks, size_mm3=self.size, previous=self.model
        )
        start = self.model.start
        return np.asarray(start if start.dtype == bool else start < 0)
