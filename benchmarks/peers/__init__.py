"""accelsurf beside the programs that a user would pick instead: the same work, in one run."""
