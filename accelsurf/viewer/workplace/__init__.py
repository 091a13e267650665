"""Actions that window and page share: requests of mouse, keys and buttons, and the state that panels show."""
