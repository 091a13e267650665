"""How many clicks a segmentation takes: a simulated person clicks into real scans and corrects what is wrong."""
