"""Trajectories: the observations of every feature inside the window."""
