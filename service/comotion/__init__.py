"""Fuses feature trajectories from several sources into hypotheses of rigid bodies.

In a program of your own::

    grouping = comotion.group(positions, times)  # whole trajectories; grouping.labels is int [T, N]

    scene = comotion.Scene(unit="m")          # online
    update = scene.push(ids, positions, t)

The package is a pure core, which computes on arrays and takes the time from its caller, and
:mod:`comotion.runtime`, the process that puts it on the wire. Each name is imported at its first use: the
compiler and SciPy take a second, which a program that only reads the configuration need not wait for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from comotion_schemas.errors import Error

    from .config import FusionConfig
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
    "Stats",
    "group",
]

_DEFINED_IN = {
    **dict.fromkeys(("AffinitySnapshot", "Fusion"), ".fusion"),
    **dict.fromkeys(("Grouping", "Scene", "group"), ".library"),
    "Error": "comotion_schemas.errors",
    "FusionConfig": ".config",
    "Stats": ".event_time.stats",
}


def __getattr__(name: str) -> Any:
    if name not in _DEFINED_IN:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_DEFINED_IN[name], __name__), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
