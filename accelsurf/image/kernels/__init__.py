"""Compiled code of images: smoothing, closing, sums of blocks, counts of values."""
