"""The experiments of the paper in 3D, all to rest: `python -m benchmarks.paper` makes the page and its figures."""
