"""Images: volumes, sequences, filters, smoothing, percentiles, noise, slices for people."""
