"""A finished run goes on: corrections, objects added, merged, split; its state on the disk."""
