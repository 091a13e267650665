"""The viewer without pictures: the session, its timeline, the frames to be drawn."""
