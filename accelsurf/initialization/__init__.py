"""First surfaces: balls, seeds, masks, thresholds and meshes, for one object or several."""
