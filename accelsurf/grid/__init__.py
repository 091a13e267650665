"""Where voxels are: geometry of a grid, the volume on it, coarser grids, boxes of voxels."""
