"""The panels of the window: each shows a part of the workplace's state, and passes on what is asked for."""
