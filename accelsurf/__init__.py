"""accelsurf: surfaces of objects in 3D images by level sets with momentum.

The public names are loaded when first used, so that ``import accelsurf`` and ``accelsurf --help`` cost nothing.

Examples
--------
>>> import accelsurf
>>> accelsurf.__version__.count(".")
2
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

#: Public name -> module that holds it.
_HOMES = {
    "AccelsurfError": "accelsurf.errors",
    "EmptyResultError": "accelsurf.errors",
    "GeometryError": "accelsurf.errors",
    "InputError": "accelsurf.errors",
    "OutputError": "accelsurf.errors",
    "UsageError": "accelsurf.errors",
    "Geometry": "accelsurf.grid.geometry",
    "Volume": "accelsurf.grid.volume",
    "LazyVolume": "accelsurf.io",
    "open_volume": "accelsurf.io",
    "read": "accelsurf.io",
    "read_labels": "accelsurf.io",
    "read_sequence": "accelsurf.io",
    "write": "accelsurf.io",
    "RunConfig": "accelsurf.settings.run_config",
    "Surface": "accelsurf.analysis.surface_mesh",
    "Contours": "accelsurf.analysis.contours",
    "Result": "accelsurf.segmentation.result",
    "segment": "accelsurf.segmentation.api",
    "evolve": "accelsurf.segmentation.api",
    "segment_objects": "accelsurf.segmentation.api",
    "TrackConfig": "accelsurf.settings.track_config",
    "track": "accelsurf.tracking.track",
    "segment_many": "accelsurf.cli.many",
    "refine": "accelsurf.segmentation.refine",
    "Refiner": "accelsurf.segmentation.refiner",
    "evaluate": "accelsurf.analysis.metrics",
    "report_of": "accelsurf.report.document",
    "show": "accelsurf.viewer.frontends.notebook",
}

#: Public name -> the one that it is another name of: a result of several objects is a Result.
_SAME = {"ObjectsResult": "Result"}

__all__ = ["__version__", *_HOMES, *_SAME]

if TYPE_CHECKING:
    from accelsurf.analysis.contours import Contours as Contours
    from accelsurf.analysis.metrics import evaluate as evaluate
    from accelsurf.analysis.surface_mesh import Surface as Surface
    from accelsurf.cli.many import segment_many as segment_many
    from accelsurf.errors import AccelsurfError as AccelsurfError
    from accelsurf.errors import EmptyResultError as EmptyResultError
    from accelsurf.errors import GeometryError as GeometryError
    from accelsurf.errors import InputError as InputError
    from accelsurf.errors import OutputError as OutputError
    from accelsurf.errors import UsageError as UsageError
    from accelsurf.grid.geometry import Geometry as Geometry
    from accelsurf.grid.volume import Volume as Volume
    from accelsurf.io import LazyVolume as LazyVolume
    from accelsurf.io import open_volume as open_volume
    from accelsurf.io import read as read
    from accelsurf.io import read_labels as read_labels
    from accelsurf.io import read_sequence as read_sequence
    from accelsurf.io import write as write
    from accelsurf.report.document import report_of as report_of
    from accelsurf.segmentation.api import evolve as evolve
    from accelsurf.segmentation.api import segment as segment
    from accelsurf.segmentation.api import segment_objects as segment_objects
    from accelsurf.segmentation.refine import refine as refine
    from accelsurf.segmentation.refiner import Refiner as Refiner
    from accelsurf.segmentation.result import Result as Result

    ObjectsResult = Result
    from accelsurf.settings.run_config import RunConfig as RunConfig
    from accelsurf.settings.track_config import TrackConfig as TrackConfig
    from accelsurf.tracking.track import track as track
    from accelsurf.viewer.frontends.notebook import show as show


def __getattr__(name: str) -> Any:
    """Load a public name from its module when it is first used."""
    name = _SAME.get(name, name)
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'accelsurf' has no attribute {name!r}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, loaded or not."""
    return sorted(__all__)
