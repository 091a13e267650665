"""Compiled code of the clicks' model: fronts and paths from clicks, random walks, a small network, distances."""
