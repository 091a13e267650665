"""One file for each file format: what its header claims, whether the file is whole, how it is written."""
