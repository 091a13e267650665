"""One run: its image is prepared, its energy made, its objects evolved; it leaves a Result."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
