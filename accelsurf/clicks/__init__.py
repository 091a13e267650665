"""Clicks as they are written: points, strokes, tables; read once, into voxels."""
