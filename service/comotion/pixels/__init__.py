"""The method of spaces in pixels: groups the current image trajectories of a window."""
