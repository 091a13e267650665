"""What pulls the surface: each energy gives its value U and its force f = -dU along the inward normal per area.

An energy follows one run. The loop calls, in this order: `start` once with the first surface; at each step
`value` and `force`; after each redistancing `follow` with what changed. See `Energy` for the protocol.
"""

from accelsurf.energies.area import AreaTerm
from accelsurf.energies.base import Energy
from accelsurf.energies.chan_vese import ChanVese
from accelsurf.energies.region_field import RegionField

__all__ = ["AreaTerm", "ChanVese", "Energy", "RegionField"]
