"""Seconds of a run by stage, as ``accelsurf segment --profile`` prints them."""

from __future__ import annotations

from collections.abc import Mapping

from accelsurf.kernels._jit import STAGE_OF_KERNEL, Stage


def seconds_by_stage(seconds: Mapping[str, float], kernels: Mapping[str, float]) -> list[tuple[str, float]]:
    """Seconds by stage.

    Parameters
    ----------
    seconds : mapping of str to float
        Of the whole run, as in the report: load, start, evolve, mesh, write, total.
    kernels : mapping of str to float
        Seconds in each kernel while it evolved. Each kernel names its stage, see `kernels._jit`.

    Returns
    -------
    list of (str, float)
        Stages in the order of a run. ``other kernels`` have no stage; ``evolve: other`` is the time between kernels;
        ``other`` is the rest. They add up to the total.

    Examples
    --------
    >>> import accelsurf.levelset, accelsurf.flows.constant_density
    >>> seconds_by_stage({"load": 1.0, "evolve": 5.0, "total": 7.0}, {"find_feet": 3.0, "kick": 1.0})
    [('load', 1.0), ('closest points', 3.0), ('flow', 1.0), ('evolve: other', 1.0), ('other', 1.0)]
    """
    stages = [(part, seconds[part]) for part in ("load", "start") if part in seconds]
    inside: list[tuple[str, float]] = []
    for stage in (*Stage, None):
        own = sum(value for name, value in kernels.items() if STAGE_OF_KERNEL.get(name) is stage)
        if own > 0:
            inside.append(("other kernels" if stage is None else stage.value, own))
    stages += inside
    if "evolve" in seconds:
        stages.append(("evolve: other", seconds["evolve"] - sum(value for _, value in inside)))
    stages += [(part, seconds[part]) for part in ("mesh", "write") if part in seconds]
    rest = seconds["total"] - sum(value for _, value in stages)
    return [*stages, ("other", rest)]


def lines(seconds: Mapping[str, float], kernels: Mapping[str, float]) -> list[str]:
    """`seconds_by_stage` as lines of text: stage, seconds, share."""
    total = max(seconds["total"], 1e-9)
    return [f"  {stage:18} {value:8.2f} s {value / total:6.1%}" for stage, value in seconds_by_stage(seconds, kernels)]
