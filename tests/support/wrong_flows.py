"""Flows with signs turned: what the tests of the flows must notice."""

from accelsurf.flows import ConstantDensity, Gradient, StepInput, StepLimits, StepPlan


class BentWrongly(ConstantDensity):
    """The 1/2 beta^2 H term with the sign that the paper prints for surfaces (after f and beta are turned inward)."""

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        return super().move(now._replace(curvature=-now.curvature), limits)


class AsPrinted(ConstantDensity):
    """The paper's printed pair for surfaces: psi_t = -beta |grad psi| and + div(1/2 beta^2 n)."""

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        move = super().move(now, limits)
        return move._replace(speed=-move.speed)


class DescentAsPrinted(Gradient):
    """The paper's printed gradient flow: psi_t = -f |grad psi|."""

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        move = super().move(now, limits)
        return move._replace(speed=-move.speed)
