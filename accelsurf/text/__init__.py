"""What people write, read once and turned into values: places, clicks, starts, tables, files of points."""
