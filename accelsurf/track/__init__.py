"""Objects through a sequence: the follower, its records and its scores."""
