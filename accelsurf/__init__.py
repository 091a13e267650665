"""accelsurf: surfaces of objects in 3D images by level sets with momentum.

The public names are in ``__init__.pyi`` and are loaded when first used, so that ``import accelsurf`` and ``accelsurf
--help`` cost nothing.

Examples
--------
>>> import accelsurf
>>> accelsurf.__version__.count(".")
2
"""

import lazy_loader

from accelsurf.version import __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = ["__version__", *__all__]
