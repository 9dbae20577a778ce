"""The KLT camera: a pure tracker core, and the process that feeds it from a camera."""

from .config import TrackerConfig
from .tracker import Tracker, Tracks

__all__ = ["Tracker", "TrackerConfig", "Tracks"]
