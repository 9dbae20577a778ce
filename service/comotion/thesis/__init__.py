"""The method of the thesis: a partition by affinity."""
