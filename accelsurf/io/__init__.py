"""Files in and out: images in every format that can be read or written, meshes, and writing that is all or nothing."""

import lazy_loader

from accelsurf.io import format_table  # noqa: F401 (enters the functions of the formats)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
