"""Stress: scenes that are not clean, and how soon the methods get over it."""

from .study import FAMILIES, run_family

__all__ = ["FAMILIES", "run_family"]
