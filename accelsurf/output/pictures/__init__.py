"""Pictures of a run: slices, curves, surfaces, movies."""
