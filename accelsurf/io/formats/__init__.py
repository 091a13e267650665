"""One file for each file format: claims of its header, check that the file is whole, writer."""
