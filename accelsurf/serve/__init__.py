"""The server: viewers that speak nnInteractive's protocol click, and the clicks' model answers. Public names alone."""
