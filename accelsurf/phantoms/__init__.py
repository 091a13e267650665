"""Synthetic volumes with exact truth: shapes known by formula, and recipes that make images of them."""
