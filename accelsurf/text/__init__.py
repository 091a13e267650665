"""Readers of what people write, once, into values: places, clicks, starts, tables, files of points."""
