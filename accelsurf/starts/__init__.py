"""First surfaces: balls, thresholds, region growing, label maps, meshes."""
