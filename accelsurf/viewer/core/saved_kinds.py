"""What a session can save."""

#: ``run`` is the configuration that repeats the run.
KINDS = ("labels", "mesh", "picture", "trace", "report", "run")
