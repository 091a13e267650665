"""The surface on the grid: a narrow band of signed distance around the zero level of psi, without images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
