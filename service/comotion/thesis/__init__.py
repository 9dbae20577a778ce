"""The method of the thesis: trajectories in, a partition by affinity out."""
