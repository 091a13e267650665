"""Geometry of grids of voxels, the volumes on them, coarser grids, boxes of voxels."""
