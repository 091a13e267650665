"""Energies: each gives its value U and its force f = -dU along the inward normal per area.

The loop calls, in this order: `start` once with the first surface; at each step `value` and `force`; after each motion
`project`, and after redistancing `follow` with the change. See `Energy` for the protocol; `ImageEnergy`
and the ``..._at_front`` functions are for energies of your own.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
