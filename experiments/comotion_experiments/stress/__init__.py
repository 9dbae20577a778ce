"""Stress: scenes that are not clean, and how soon the methods get over it."""

from .catalogue import FAMILIES, Family, find_families
from .experiment import METHODS, REPORTED_SEEDS, run_family, run_method

__all__ = ["FAMILIES", "METHODS", "REPORTED_SEEDS", "Family", "find_families", "run_family", "run_method"]
