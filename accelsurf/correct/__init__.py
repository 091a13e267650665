"""Corrections of a finished run: clicks, objects added, merged, split; its state on the disk."""
