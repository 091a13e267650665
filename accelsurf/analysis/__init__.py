"""Mesh, contours and measures of a surface, its agreement with a reference, and its quality without one."""
