"""A case, from its files to its files: a segmentation or a tracking, signals, progress, and the end in words."""
