"""Comparator: the affinity of Brox and Malik (2010), with two clusterings."""

from .comparison import CLUSTERINGS, Comparison, compare
from .pair_affinity import affinity

__all__ = ["CLUSTERINGS", "Comparison", "affinity", "compare"]
