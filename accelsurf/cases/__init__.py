"""A case, from its files to its files: a segmentation or a tracking, signals, progress, and the end in words."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
