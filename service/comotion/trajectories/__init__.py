"""Trajectories: released instants in, the observations of every feature inside the window out."""
