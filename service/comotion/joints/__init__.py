"""Joints: poses of two bodies in, how one can move against the other out."""
