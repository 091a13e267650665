"""The scene: surface in 3D, slices, chart; drawn the same way for every front end."""
