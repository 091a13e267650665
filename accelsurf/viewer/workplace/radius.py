"""The radius of click, ball and brush as window and page show it: in the unit of the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.viewer.core.status import Status
from accelsurf.viewer.workplace.amounts import amount, from_read, read_in
from accelsurf.viewer.workplace.feature import Feature
from accelsurf.viewer.workplace.tool import finest

#: Ends of the slider: voxels of the smallest spacing, and parts of the image's longest side.
LEAST, MOST = 0.5, 0.4


class RadiusFeature(Feature):
    """Shows the radius on a slider, and takes what is set there."""

    def __init__(self, workplace: Any) -> None:
        super().__init__(workplace)
        self._unit, self._per = read_in("mm", workplace.scene.unit)

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"set_radius": lambda value: self.workplace.request("radius", from_read(value, self._per))}

    def state(self, status: Status) -> dict[str, Any]:
        geometry = self.workplace.scene.geometry
        least, longest = LEAST * finest(geometry), float(max(geometry.extent_mm))
        row = amount(least, MOST * longest, self.workplace.radius, 2.0, longest, per=self._per)
        return {"radius_row": {"unit": self._unit, **row}}
