"""Measures of a result: meshes, statistics, agreement with a reference, quality without one."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
