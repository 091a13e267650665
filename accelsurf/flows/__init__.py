"""How the surface moves under a force: each flow turns forces into speeds and owns its stable time step.

A flow knows no image. beta is the speed along the inward normal N (beta > 0 shrinks), psi_t = beta |grad psi|.
"""

from accelsurf.flows.base import Flow, Limits, Move
from accelsurf.flows.constant_density import ConstantDensity
from accelsurf.flows.gradient import Gradient

__all__ = ["ConstantDensity", "Flow", "Gradient", "Limits", "Move"]
