"""Compiled loops of the rigid method on plain arrays, of the conventions of :mod:`comotion.geometry`."""
