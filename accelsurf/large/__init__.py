"""Images larger than memory: windows, levels of a pyramid, groups of objects."""
