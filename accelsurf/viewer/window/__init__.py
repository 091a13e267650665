"""The viewer in a window of Qt."""
