"""The core as a library: arrays in, labels and hypotheses out; no messages, processes or clocks."""

from .grouping import group
from .results import Grouping
from .scene import Scene

__all__ = ["Grouping", "Scene", "group"]
