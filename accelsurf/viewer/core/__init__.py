"""What the viewer knows without drawing anything: the session, its timeline, the frames to be drawn."""
