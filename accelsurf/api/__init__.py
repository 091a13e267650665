"""Python functions on images: segment, segment_objects, evolve."""
