"""Outputs of a run besides labels and meshes: the JSON report, tables, pictures."""
