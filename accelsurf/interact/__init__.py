"""Interaction: a person's gestures on the objects of an image, the same for every client."""
