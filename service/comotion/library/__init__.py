"""The core as a library, for arrays; no messages, processes or clocks."""

from .grouping import group
from .results import Grouping
from .scene import Scene

__all__ = ["Grouping", "Scene", "group"]
