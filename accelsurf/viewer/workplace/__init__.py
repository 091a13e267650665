"""What window and page share: what a person can ask for, by mouse, key or button, and what panels show of it."""
