"""In the trajectories of a group, out when, where and how fast it appeared."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Slots, thinned
from ..trajectories.window import Window

# Trajectories that are looked at, evenly drawn: a centroid needs no more.
_MOST = 64
# s; the velocity is that of the first so many seconds.
_FIRST = 0.4


@dataclass(frozen=True)
class Appearance:
    """A group when half of its members were first observed.

    Attributes
    ----------
    stamp_ns
        That time.
    positions
        float64 [m, dim], of the members that were observed then.
    velocity
        float64 [dim], of their centroid right after it; zero where nothing is known.
    """

    stamp_ns: int
    positions: Floats
    velocity: Floats


def appearance(window: Window, slots: Slots) -> Appearance:
    """When and where the trajectories in `slots` intp [n] > 0 appeared, as far as the window tells."""
    some = thinned(slots, _MOST)
    first = window.times[some, window.start[some]]
    stamp_ns = int(np.sort(first)[(len(first) - 1) // 2])
    seen = some[first <= stamp_ns]
    positions = _positions_at(window, seen, stamp_ns)
    last_ns = int(window.times[seen, window.stop[seen] - 1].min())
    later_ns = min(stamp_ns + int(_FIRST * 1e9), last_ns)
    velocity = np.zeros(window.dim)
    if later_ns > stamp_ns:
        way = _positions_at(window, seen, later_ns).mean(0) - positions.mean(0)
        velocity = way / ((later_ns - stamp_ns) * 1e-9)
    return Appearance(stamp_ns, positions, velocity)


def _positions_at(window: Window, slots: Slots, stamp_ns: int) -> Floats:
    """Newest position of each trajectory at a time, float64 [n, dim]; the first where it came later."""
    found = np.empty((len(slots), window.dim))
    for n, slot in enumerate(slots.tolist()):
        start, stop = window.start[slot], window.stop[slot]
        at = start + np.searchsorted(window.times[slot, start:stop], stamp_ns, side="right") - 1
        found[n] = window.positions[slot, max(at, start)]
    return found
