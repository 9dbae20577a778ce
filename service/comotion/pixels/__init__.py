"""A window of image trajectories in, a partition of the current ones out: the method of spaces in pixels."""
