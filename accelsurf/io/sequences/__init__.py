"""Sequences of images, read and written."""
