"""accelsurf as the benchmark drives it: clicks as a person types them, with everything else left to the program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from accelsurf.api.segment import segment
from accelsurf.clicks.model import ClickModel, Scene, click_model
from accelsurf.clicks.model.network import Network
from accelsurf.clicks.model.windows import sizes_in_box
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Clicks
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from benchmarks.clicks.games import Hints, Segmenter
from benchmarks.clicks.person import Mask, PersonClick, voxels_of


def segmenter(name: str) -> Segmenter:
    """Our methods by name."""
    return {"accelsurf": Corrected, "accelsurf-rerun": Rerun, "accelsurf-start": StartAlone}[name]


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
    if click.line:
        pen = click.radius / min(image.geometry.spacing)
        return "path:" + ";".join(f"{x},{y},{z},{pen!r}" for z, y, x in click.line) + "vox"
    place = ",".join(repr(value) for value in click.centre)
    one_voxel = click.radius <= 0.5 * min(image.geometry.spacing)
    return f"point:{place}" if one_voxel else f"ball:{place},{click.radius!r}"


def options_of(hints: Hints) -> dict[str, Any]:
    """Settings of what a person gives before the first click.

    Examples
    --------
    >>> options_of(Hints(12.5, (slice(1, 4), slice(2, 5), slice(3, 6))))
    {'size': '12.500000mm3', 'box': '3,2,1,5,4,3vox'}
    """
    out = {} if hints.size_mm3 is None else {"size": f"{hints.size_mm3:.6f}mm3"}
    if hints.box is not None:
        ends = [side.start for side in hints.box[::-1]] + [
            side.stop - 1 for side in hints.box[::-1]
        ]
        out["box"] = ",".join(map(str, ends)) + "vox"
    return out


class Rerun:
    """`accelsurf segment` with all clicks so far, from the beginning at every click."""

    def __init__(self, image: Volume, hints: Hints) -> None:
        self.image, self.options = image, options_of(hints)
        self.texts: dict[str, list[str]] = {"inside": [], "outside": []}
        self.confidence: float | None = None

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        self.texts[click.side].append(text_of(click, self.image))
        given = {side: tuple(texts) for side, texts in self.texts.items()}
        result = segment(self.image, config=RunConfig(**given, **self.options))
        self.confidence = confidence(result)
        return np.asarray(result.labels > 0)


class Corrected:
    """`accelsurf segment` at the first click, `accelsurf refine` at every later one."""

    def __init__(self, image: Volume, hints: Hints) -> None:
        self.image, self.options = image, options_of(hints)
        self.result: Any = None

    @property
    def confidence(self) -> float | None:
        """Probability, by the program, that the labels are good."""
        return confidence(self.result)

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        from accelsurf.interact.refine import refine

        given: dict[str, Any] = {click.side: (text_of(click, self.image),)}
        if self.result is None:
            self.result = segment(
                self.image, config=RunConfig(**given, **self.options, keep_state="yes")
            )
        else:
            self.result = refine(self.result, **given)
        return np.asarray(self.result.labels > 0)


def confidence(result: Any) -> float | None:
    """Probability, by the program, that a result is good; None without a result, or for several objects."""
    quality = None if result is None else result.quality
    return None if quality is None else float(quality.probability)


class StartAlone:
    """The object that the model of the clicks shows, where the surface would begin; by other networks, if given."""

    def __init__(
        self, image: Volume, hints: Hints, asked: Mapping[str, Network] | None = None
    ) -> None:
        self.asked = asked
        self.scene = Scene((image.as_float32(),), image.geometry.spacing)
        self.image, self.size = image, hints.size_mm3
        if hints.box is not None:
            is_open = np.zeros(image.geometry.shape, np.bool_)
            is_open[hints.box] = True
            box_mm3 = float(np.count_nonzero(is_open)) * image.geometry.voxel_volume
            self.scene = self.scene._replace(open=is_open, sizes=sizes_in_box(box_mm3))
        self.clicks = Clicks((), image.geometry.shape)
        self.model: ClickModel | None = None

    def click(self, click: PersonClick) -> Mask:
        """Labels after one click more."""
        self.clicks = self.clicks.with_more([voxels_of(click, self.image.geometry)])
        self.model = click_model(
            self.scene, self.clicks, size_mm3=self.size, previous=self.model, asked=self.asked
        )
        return self.model.inside_on(whole_box(self.image.geometry.shape))

    def other_answers(self) -> list[Mask]:
        """Labels of the other answers to the clicks so far, which a person may choose after the first one."""
        others = range(0 if self.model is None else len(self.model.answers) - 1)
        return [self._other(number).inside_on(whole_box(self.clicks.shape)) for number in others]

    def take(self, number: int) -> Mask:
        """Labels of one of `other_answers`, from which the next click goes on."""
        self.model = self._other(number)
        return self.model.inside_on(whole_box(self.clicks.shape))

    def _other(self, number: int) -> ClickModel:
        assert self.model is not None
        answer = self.model.answers[1 + number].number
        return click_model(self.scene, self.clicks, size_mm3=self.size, answer=answer)
