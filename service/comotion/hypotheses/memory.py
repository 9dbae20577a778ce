"""Remembers absent hypotheses, and recognises them by features, place and extent."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from comotion_schemas import Hypothesis

from ..arrays import Floats, Slots, find, thinned
from ..partition import PoseReference
from ..trajectories.window import Window
from .records import Current, Trace

# s; lost features count among the last members of their hypothesis for so long.
_LAST_MEMBERS = 2.0
# s; a body is expected to keep its velocity for so long, after it was lost and before it is seen again.
_CARRY = 0.5
# s; the place about which a body moves is a mean over so long, and it is expected to return to it within so
# long.
_PLACE, _BACK = 5.0, 2.0
# Share of a body's extent by which the centroid of other features of it errs, share of the way at the usual
# speed by which a prediction errs, and error of the logarithm of an extent that is estimated from few
# features. Chosen on true groups of the bodies of stress scenes with even seeds.
_CENTROID_ERROR, _WAY_ERROR, _EXTENT_ERROR = 0.3, 0.5, 0.3
# Squared distance, in standard deviations, up to which a group may be the one that is absent: 4 of them.
_GATE = 16.0
# nat; price of a jump.
_JUMP = 5.0
# Trajectories by which a group is known where it appears, evenly drawn: a centroid needs no more.
_MAX_SEEN = 64
# s; its velocity then is that of the first so many seconds.
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
    some = thinned(slots, _MAX_SEEN)
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


def seen(
    before: Trace | None,
    stamp_ns: int,
    current: Current,
    description: Hypothesis,
    reference: PoseReference,
    *,
    static: bool,
) -> Trace:
    """The trace of a hypothesis with members among the current trajectories."""
    mine = current.members[description.id]
    keys, stamps, positions = current.keys[mine], np.full(len(mine), stamp_ns), current.positions[mine]
    place, spread = positions.mean(0), 0.0
    if before is not None:
        place, spread = _followed(before, place, (stamp_ns - before.stamp_ns) * 1e-9)
    if before is not None and not np.array_equal(keys, before.keys):
        recent = before.stamps >= stamp_ns - int(_LAST_MEMBERS * 1e9)
        lost = recent & (find(before.keys, current.keys) < 0)
        keys = np.concatenate([keys, before.keys[lost]])
        stamps = np.concatenate([stamps, before.stamps[lost]])
        positions = np.vstack([positions, before.positions[lost]])
    return Trace(keys, stamps, positions, description, static, reference, place, spread)


def recognised(
    absent: Mapping[int, Trace], newcomers: Mapping[int, Appearance | None], margin: float
) -> dict[int, int]:
    """Absent hypothesis that each new group is, {new: absent}, by place, motion and extent.

    Parameters
    ----------
    absent
        Remembered hypotheses without a current member, by id.
    newcomers
        When and where new groups appeared, by id; None for a static one.
    margin
        By how much, in nat, a pair must be better than every assignment without it.
    """
    found = {}
    static = [one for one, trace in absent.items() if trace.static]
    for new in (new for new, first in newcomers.items() if first is None):
        if static:
            # The static body is one, wherever it is seen: the last one known goes on.
            found[new] = max(static, key=lambda one: absent[one].stamp_ns)
    rows = [one for one in absent if one not in static]
    groups = {new: first for new, first in newcomers.items() if first is not None}
    if rows and groups:
        columns = list(groups)
        costs = _costs([absent[one] for one in rows], list(groups.values()))
        found |= {columns[c]: rows[r] for r, c in clear_pairs(costs, margin)}
    return found


def _costs(traces: list[Trace], groups: list[Appearance]) -> Floats:
    """Negative log likelihood of each pair, float64 [traces, groups]; infinite where it cannot be.

    A body keeps its velocity for a moment, and moves about a place in the long run. Where a replay jumps,
    only the latter holds.
    """
    speeds = [float(np.linalg.norm(trace.velocity)) for trace in traces]
    usual = float(np.median(speeds))
    costs = np.full((len(traces), len(groups)), np.inf)
    for r, (trace, speed) in enumerate(zip(traces, speeds, strict=True)):
        for c, group in enumerate(groups):
            costs[r, c] = min(_continued(trace, group, max(speed, usual)), _jumped(trace, group))
    return costs


def clear_pairs(costs: Floats, margin: float) -> list[tuple[int, int]]:
    """Pairs of the best assignment that every assignment without them is worse than by a margin.

    Parameters
    ----------
    costs
        float64 [n, m]; infinite for pairs that cannot be.
    margin
        In the unit of the costs.
    """
    possible = np.isfinite(costs)
    if not possible.any():
        return []
    # As many pairs as can be are matched; what cannot be costs more than any difference among the others.
    worst = float(np.ptp(costs[possible])) * min(costs.shape) + 1e3
    filled = np.where(possible, costs - costs[possible].min(), worst)
    rows, columns = linear_sum_assignment(filled)
    best = filled[rows, columns].sum()
    found = []
    for r, c in zip(rows.tolist(), columns.tolist(), strict=True):
        if not possible[r, c]:
            continue
        without = filled.copy()
        without[r, c] = worst
        if without[linear_sum_assignment(without)].sum() - best >= margin:
            found.append((r, c))
    return found


def _followed(before: Trace, now: Floats, seconds: float) -> tuple[Floats, float]:
    """Place and spread of a trace after so many seconds, with its centroid at `now` float64 [dim]."""
    share = 1 - float(np.exp(-max(seconds, 0.0) / _PLACE))
    way = now - before.place
    return before.place + share * way, (1 - share) * (before.spread + share * float(way @ way) / len(way))


def _continued(trace: Trace, group: Appearance, speed: float) -> float:
    """Cost of a group that appears where a trace has moved to at a usual speed; infinite beyond the gate."""
    centroid, extent = _place(trace.brought_up)
    away = max((group.stamp_ns - trace.stamp_ns) * 1e-9, 0.0)
    stays, carried = float(np.exp(-away / _BACK)), min(_CARRY, away / 2)
    expected = trace.place + stays * (centroid + carried * trace.velocity - trace.place)
    way = _WAY_ERROR * speed * min(away, _BACK)
    error = (_CENTROID_ERROR * extent) ** 2 + (1 - stays**2) * trace.spread + way**2
    return _cost(group, carried * group.velocity + expected, extent, error)


def _jumped(trace: Trace, group: Appearance) -> float:
    """Likewise, of a group that appears anywhere where a trace has been."""
    extent = _place(trace.brought_up)[1]
    return _cost(group, trace.place, extent, (_CENTROID_ERROR * extent) ** 2 + trace.spread) + _JUMP


def _cost(group: Appearance, expected: Floats, extent: float, variance: float) -> float:
    where, size = _place(group.positions)
    off = float(((where - expected) ** 2).sum() / variance) + (np.log(size / extent) / _EXTENT_ERROR) ** 2
    return float(off / 2 + len(where) * np.log(variance) / 2) if off <= _GATE else np.inf


def _place(positions: Floats) -> tuple[Floats, float]:
    """Centroid float64 [dim], and root mean square distance from it."""
    centroid = positions.mean(0)
    return centroid, float(np.sqrt(((positions - centroid) ** 2).sum(1).mean())) + 1e-9
