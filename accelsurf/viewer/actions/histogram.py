"""The histogram of the image, and of what is in the object, with the bounds of the energy."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.settings import energy_expression
from accelsurf.settings.energy_expression import with_setting
from accelsurf.viewer.actions.tool import AllActions, Feature, number, whole, word
from accelsurf.viewer.core.frame import Frame, SurfaceFrame
from accelsurf.viewer.core.status import Status, View

#: Bars; percentiles of the image at their ends; voxels that are counted at most, spread evenly.
BARS, ENDS, SAMPLE = 96, (0.05, 99.95), 300_000
#: Seconds from one histogram of the object to the next while the run goes on.
PAUSE_SECONDS = 1.0
#: The bounds that are drawn, of the term that has them.
BOUNDED, BOUNDS = "threshold", ("LO", "HI")
#: Largest magnitude of a bound.
MAX_BOUND = 1e30


class HistogramFeature(Feature):
    """Counts the values of the image once, those in the object when it has changed; moves the bounds of the energy."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        image = sample(actions.session.volume.array)
        low, high = (float(v) for v in np.percentile(image, ENDS))
        if not low < high:
            low, high = float(np.min(image)), float(np.max(image))
        self._edges = np.linspace(low, high if high > low else low + 1.0, BARS + 1)
        self._image, self._object = self._heights(image), [0.0] * 0
        self._counted_at = 0.0
        self._state: dict[str, Any] = {}

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"bound": self._bound}

    def state(self, status: Status) -> dict[str, Any]:
        if self._state.get("object") is not self._object:
            ends = {"low": float(self._edges[0]), "high": float(self._edges[-1])}
            self._state = {**ends, "image": self._image, "object": self._object}
        return {"histogram": self._state, "bounds": bounds(status)}

    def update(self, view: View) -> None:
        now = time.monotonic()
        if not view.status.playing or now - self._counted_at > PAUSE_SECONDS:
            self._counted_at = now
            values = values_inside(view.frame, self.actions.session.volume.array)
            self._object = self._heights(values) if values.size else []

    def _heights(self, values: NDArray[Any]) -> list[float]:
        """Height of each bar: the root of its share, so that small objects are seen beside their background."""
        counts, _ = np.histogram(np.clip(values, self._edges[0], self._edges[-1]), self._edges)
        return [round(float(v), 3) for v in np.sqrt(counts / max(int(counts.max()), 1))]

    def _bound(self, place: Any, key: Any, value: Any) -> None:
        """Move a bound to a value of the image; the other one stays."""
        place, key = whole(place, 0, energy_expression.MAX_TERMS), word(key, BOUNDS)
        energy = self.actions.session.status.settings.energy
        terms = energy_expression.parse(energy)
        if place >= len(terms) or terms[place].name != BOUNDED:
            raise UsageError(f"bound: term {place + 1} of {energy} has no bounds")
        changed = with_setting(energy, place, key, f"{number(value, -MAX_BOUND, MAX_BOUND):.6g}")
        self.actions.ask(self.actions.session.change(energy=changed))


def bounds(status: Status) -> list[dict[str, Any]]:
    """The bounds in force: ``term``, the place of the term; ``key``, LO or HI; ``value``; ``given``: as a number."""
    found = []
    for place, term in enumerate(energy_expression.parse(status.settings.energy)):
        resolved = status.terms[place] if place < len(status.terms) else {}
        for key in BOUNDS if term.name == BOUNDED and resolved.get("term") == BOUNDED else ():
            if resolved.get(key) is not None:
                given = isinstance(term.settings.get(key), float)
                found.append({"term": place, "key": key, "value": float(resolved[key]), "given": given})
    return found


def sample(image: NDArray[Any]) -> NDArray[Any]:
    """Return at most `SAMPLE` values of an image, on a coarser grid of its own voxels."""
    return image[_sampled(image.shape)].ravel()


def _sampled(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Every so many voxels along each axis, at most `SAMPLE` in all."""
    stride, sides = [1] * len(shape), np.array(shape)
    while np.prod(-(-sides // stride)) > SAMPLE:
        stride[int(np.argmax(sides / stride))] += 1
    return tuple(slice(None, None, step) for step in stride)


def values_inside(frame: Frame, image: NDArray[Any]) -> NDArray[Any]:
    """Return at most `SAMPLE` values of an image in each object of a frame."""
    parts = [_values_in(surface, image) for surface in frame.surfaces if surface.has_surface]
    return np.concatenate(parts) if parts else np.zeros(0)


def _values_in(surface: SurfaceFrame, image: NDArray[Any]) -> NDArray[Any]:
    coarse = _sampled(surface.psi.shape)
    index = np.argwhere(surface.psi[coarse] < 0) * [part.step for part in coarse]
    at = np.rint(surface.to_image(index)).astype(np.int64)
    z, y, x = np.clip(at, 0, np.array(image.shape) - 1).T
    return np.asarray(image[z, y, x])
