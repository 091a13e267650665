"""Pictures of a run that people look at and steer: one scene for desktop, browser, notebook and movie.

Nothing is imported here: what draws needs PyVista, what runs the solver (`frame`, `session`) does not.
"""
