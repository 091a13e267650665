"""Whole tasks in the window, by mouse and keys alone: from opening a scan to a saved mesh and its volume in ml."""
