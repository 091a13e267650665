"""Flows: they turn forces into speeds, and each states the time step in which it is stable.

A flow knows no image. beta is the speed along the inward normal N (beta > 0 shrinks), psi_t = beta |grad psi|; where
the whole velocity V advects the surface, psi_t = -V . grad psi.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
