"""Images larger than memory: windows, levels of a pyramid, groups of objects."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
