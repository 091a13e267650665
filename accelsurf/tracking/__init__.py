"""Objects through a sequence of images: a surface that keeps its momentum from frame to frame."""
