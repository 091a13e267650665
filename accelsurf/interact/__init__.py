"""Interaction: a person's gestures on the objects of an image, the same for every client."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
