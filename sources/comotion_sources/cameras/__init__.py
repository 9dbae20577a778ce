"""Cameras: one interface and one opening function for devices, streams, videos and folders."""
