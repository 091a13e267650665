"""The evolution of a surface: the loop of steps, their records, convergence, the energy budget, levels, checkpoints."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
