"""Many cases with one command: which they are, how many at once, worker processes, tables of what came out."""
