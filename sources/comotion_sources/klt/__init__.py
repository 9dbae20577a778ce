"""The KLT camera source: a pure feature tracker, and the process that runs it on a camera."""

from .config import TrackerConfig
from .tracker import Tracker, Tracks

__all__ = ["Tracker", "TrackerConfig", "Tracks"]
