"""Many cases with one command: their choice, how many run at once, worker processes, tables of their outcomes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
