"""Many cases with one command: their choice, how many run at once, worker processes, tables of their outcomes."""
