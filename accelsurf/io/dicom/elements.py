"""Elements of a DICOM data set as texts and numbers, whatever a file has made of them."""

from __future__ import annotations

import math
from typing import Any

Floats = tuple[float, ...]


class Elements:
    """A data set whose elements are looked up once: every frame asks for the same ones.

    Parameters
    ----------
    dataset : pydicom.Dataset
    """

    def __init__(self, dataset: Any) -> None:
        self.dataset = dataset
        self._known: dict[str, Any] = {}

    def get(self, name: str) -> Any:
        """Return a value by its keyword; None where there is none."""
        if name not in self._known:
            self._known[name] = self.dataset.get(name)
        return self._known[name]


def text(dataset: Any, name: str) -> str:
    """An element as text; empty where there is none."""
    value = dataset.get(name)
    return "" if value is None else " ".join(str(value).split())[:120]


def numbers_of(dataset: Any, name: str, count: int) -> Floats | None:
    """Read a number of finite numbers; None where the element has others."""
    value = None if dataset is None else dataset.get(name)
    if value is None or value == "":
        return None
    parts = [value] if isinstance(value, (int, float, str)) else list(value)
    found = tuple(float(part) for part in parts if part is not None)
    return found if len(found) == count and all(map(math.isfinite, found)) else None


def number_of(dataset: Any, name: str) -> float | None:
    """A finite number; None where the element has none."""
    found = numbers_of(dataset, name, 1)
    return None if found is None else found[0]


def listed(value: Any) -> list[str]:
    """The parts of an element in capitals."""
    parts = [] if value is None else [value] if isinstance(value, str) else list(value)
    return [str(part).upper() for part in parts]
