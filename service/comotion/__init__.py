"""Fuses feature trajectories from several sources into hypotheses of rigid bodies.

The package is a pure core - arrays in, arrays out, time injected - and :mod:`comotion.runtime`,
the process that puts it on the wire.
"""

from .config import FusionConfig
from .event_time.sources import SourceHealth
from .event_time.stats import Stats
from .fusion import AffinitySnapshot, Fusion

__all__ = ["AffinitySnapshot", "Fusion", "FusionConfig", "SourceHealth", "Stats"]
