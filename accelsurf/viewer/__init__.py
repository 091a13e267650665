"""Pictures of a run that the user watches and steers: one scene for desktop, browser, notebook and movie.

Nothing is imported here: `scene`, and the rooms that draw with it, need PyVista; `core`, which runs the solver, does
not.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
