"""Pictures of a run that the user watches and steers: one scene for desktop, browser, notebook and movie.

Nothing is imported here: `scene`, and the rooms that draw with it, need PyVista; `core`, which runs the solver, does
not.
"""
