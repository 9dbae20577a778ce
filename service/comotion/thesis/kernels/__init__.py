"""Compiled code of the thesis' method, and nothing else: samples, their sums, and products for 2-means."""
