"""``accelsurf evaluate``: how well two label maps agree."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def evaluate(
    pred: Annotated[Path, Parameter(name="PRED")],
    ref: Annotated[Path, Parameter(name="REF")],
    *,
    as_json: Annotated[bool, Parameter(name="--json", negative=(), show_default=False)] = False,
) -> int:
    """Measure how well two label maps agree: overlap, volume, and surface distances in mm.

    Every label above 0 is the object. Both maps must lie on the same grid. A number that is not defined, such
    as the distance to an empty map, is shown as - (null in JSON).

    Parameters
    ----------
    pred
        The label map to judge.
    ref
        The reference.
    as_json
        Print JSON.
    """
    from accelsurf import io
    from accelsurf.analysis import metrics
    from accelsurf.io.file_set import finish_killed_runs
    from accelsurf.report.document import to_json

    for path in (pred, ref):
        finish_killed_runs(path.parent)
    found = metrics.evaluate(io.read_labels(pred), io.read_labels(ref)).to_dict()
    if as_json:
        print(to_json({"pred": str(pred.absolute()), "ref": str(ref.absolute()), **found}))
        return 0
    width = max(map(len, found))
    for name, value in found.items():
        print(f"{name:{width}}  {'-' if value is None else format(value, '.6g')}")
    return 0
