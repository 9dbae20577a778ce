"""The core as a library: arrays in, labels and hypotheses out; no messages, processes or clocks."""

from .grouping import Grouping, group
from .scene import Scene

__all__ = ["Grouping", "Scene", "group"]
