"""What a surface is: its mesh, contours, measures, agreement with a reference, and whether to trust it."""
