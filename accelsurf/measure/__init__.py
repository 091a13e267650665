"""Measures of a result: meshes, statistics, agreement with a reference, quality without one."""
