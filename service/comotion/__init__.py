"""Fuses feature trajectories from several sources into hypotheses of rigid bodies.

In a program of your own::

    found = comotion.group(positions, times)  # whole trajectories; found.labels is int [T, N]

    scene = comotion.Scene(unit="m")          # online
    update = scene.push(ids, positions, t)

The package is a pure core - arrays in, arrays out, time injected - and :mod:`comotion.runtime`,
the process that puts it on the wire.
"""

from comotion_schemas.errors import Error

from .config import FusionConfig
from .event_time.sources import SourceHealth
from .event_time.stats import Stats
from .fusion import AffinitySnapshot, Fusion
from .library import Grouping, Scene, group

__all__ = [
    "AffinitySnapshot",
    "Error",
    "Fusion",
    "FusionConfig",
    "Grouping",
    "Scene",
    "SourceHealth",
    "Stats",
    "group",
]
