"""A learned reading of clicks: a small network, voxel by voxel, over maps that marches and walks make of an image.

Trained on scenes that are drawn and painted on the fly, never on a scan: `python -m benchmarks.clicks.reading train`.
"""
