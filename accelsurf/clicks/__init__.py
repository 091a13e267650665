"""Clicks as they are written: points, strokes, tables; read once, into voxels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
