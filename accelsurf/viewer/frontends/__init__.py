"""Where the scene is shown: desktop window, page in a browser, notebook, movie, one HTML file."""
