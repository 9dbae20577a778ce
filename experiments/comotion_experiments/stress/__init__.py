"""Stress: scenes that are not clean, and how soon the methods get over it."""

from .study import FAMILIES, METHODS, REPORTED_SEEDS, Family, find_families, markdown, run_family, run_method

__all__ = [
    "FAMILIES",
    "METHODS",
    "REPORTED_SEEDS",
    "Family",
    "find_families",
    "markdown",
    "run_family",
    "run_method",
]
