"""Front ends of the scene: desktop window, page in a browser, notebook, movie, one HTML file."""
