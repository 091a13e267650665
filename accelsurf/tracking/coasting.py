"""A surface that moves by its own velocity alone, in steps that the grid resolves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.flows import StepInput, StepLimits, StepPlan
from accelsurf.flows.accelerated import Accelerated
from accelsurf.flows.step_limits import voxel_rates
from accelsurf.tracking.boxed_surface import BoxedSurface, Floats, sample_fields, transferred

#: Voxels that a surface may move in a step.
CFL = 0.5
#: Steps of a motion at most: speeds that run away, as where paths cross or a surface of constant density is folded, end
#: it.
MAX_STEPS = 200
#: A remainder of the time below this part of it is rounding.
END = 1e-9


def coast(
    on: BoxedSurface, flow: Accelerated, fields: list[np.ndarray], duration: float, points: Floats
) -> tuple[BoxedSurface, list[np.ndarray], Floats]:
    """Move a surface for ``duration`` > 0 by a flow without any force.

    Parameters
    ----------
    on : BoxedSurface
        Moved in place where its box has room enough.
    flow : Accelerated
        With a constant friction.
    fields : list of ndarray (n,)
        Of the flow, now.
    duration : float
    points : ndarray (m, 3)
        Material points near the surface, mm along the grid's axes.

    Returns
    -------
    BoxedSurface, list of ndarray, ndarray
        The surface, its fields and the points, all of the same moment.
    """
    flow.start_moving(on.surface, fields)
    left, points = duration, points.copy()
    for _ in range(MAX_STEPS):
        if left <= END * duration or not on.surface.size:
            break
        if on.is_tight():
            on = _relaid(on, flow)
        now = _now(on, flow)
        # The step follows the speed now; its curvature may speed a surface up, which must not be clipped.
        step = min(left, CFL / max(_fastest(now, flow), CFL / duration))
        plan = flow.move(now, StepLimits(2.0 * CFL, 100.0, step))
        if not plan.dt > 0:
            break
        if len(points):
            points += plan.dt * _velocity_at(on, plan, points)
        surface = on.surface
        if plan.velocity is None:
            surface.advance(plan.speed, plan.dt)
            flow.set_fields(surface.redistance(flow.fields).fields)
        else:
            surface.advect(plan.velocity, plan.dt)
            flow.set_fields(surface.redistance(flow.fields, (plan.velocity, plan.dt)).fields)
        left -= plan.dt
    if on.surface.size:
        flow.synchronize(_now(on, flow))
    return on, flow.fields, points


def _now(on: BoxedSurface, flow: Accelerated) -> StepInput:
    """The surface without any force."""
    surface = on.surface
    front = surface.front(flow.stencil_width(surface))
    none = np.zeros(surface.size, np.float32)
    return StepInput(surface, front, none, surface.curvature(front), surface.fraction_and_area()[1], 0.0)


def _fastest(now: StepInput, flow: Accelerated) -> float:
    """The largest speed of the front, voxels per unit of time."""
    surface, velocity = now.surface, flow.fields[:3]
    if len(velocity) < 3:
        rates = voxel_rates(surface, now.front, velocity[0])
    else:
        h = surface.grid.hz, surface.grid.hy, surface.grid.hx
        rates = np.sqrt(sum((field / step) ** 2 for field, step in zip(velocity, h, strict=True)))
    return float(rates[now.front].max(initial=0.0))


def _relaid(on: BoxedSurface, flow: Accelerated) -> BoxedSurface:
    """The surface on a box with more room, and the fields of the flow there."""
    larger = on.with_room([max(8, n // 4) for n in on.surface.shape])
    flow.set_fields(transferred(on, flow.fields, larger))
    return larger


def _velocity_at(on: BoxedSurface, plan: StepPlan, points: Floats) -> NDArray[np.float64]:
    """Velocity (m, 3) of material points near the surface."""
    velocity = plan.velocity
    if velocity is None:
        velocity = plan.speed[:, None] * on.surface.normals()
    values, _ = sample_fields(on, [np.ascontiguousarray(velocity[:, c]) for c in range(3)], points)
    return np.asarray(values)
