"""Flows: they turn forces into speeds, and each states the time step in which it is stable.

A flow knows no image. beta is the speed along the inward normal N (beta > 0 shrinks), psi_t = beta |grad psi|; where
the whole velocity V advects the surface, psi_t = -V . grad psi.
"""

from accelsurf.flows.constant_density import ConstantDensity
from accelsurf.flows.descent import Gradient, HeavyBall, Sobolev
from accelsurf.flows.flowable_mass import FlowableMass
from accelsurf.flows.noise import Noise
from accelsurf.flows.protocol import EnergyRates, Flow, StepInput, StepLimits, StepPlan
from accelsurf.flows.region_mass import RegionMass
from accelsurf.flows.region_pressure import RegionPressure

__all__ = [
    "EnergyRates",
    "ConstantDensity",
    "Flow",
    "FlowableMass",
    "Gradient",
    "StepLimits",
    "HeavyBall",
    "StepPlan",
    "Noise",
    "RegionMass",
    "RegionPressure",
    "StepInput",
    "Sobolev",
]
