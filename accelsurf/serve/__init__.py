"""The server: viewers that speak nnInteractive's protocol click, and the clicks' model answers. Public names alone."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
