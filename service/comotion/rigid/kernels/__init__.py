"""Compiled loops of the rigid method on plain arrays, and the records that they take as arguments.

Arrays are float64, indices intp and times int64 nanoseconds unless said otherwise. Points have three
coordinates; in 2-D the third is zero and rotations are about z. P rows, F frames, K bodies.
"""
