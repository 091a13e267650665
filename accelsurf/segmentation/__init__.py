"""From an image and a start to a result: preprocessing, the energy, the run of one or several objects."""
