"""Recognises hypotheses that have no current member in new groups, by place and extent."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..arrays import Floats, Slots, last_true, thinned
from ..trajectories.window import Window
from .records import Record

# s; a body is expected to return to the place about which it moves within so long.
_BACK = 2.0
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


Appearance = tuple[int, Floats]
"""When half of the members of a group were first observed, ns; where they were then, float64 [m, dim]."""


def appearance(window: Window, slots: Slots) -> Appearance:
    """When and where the trajectories in `slots` intp [n] > 0 appeared, as far as the window tells."""
    drawn = thinned(slots, _MAX_SEEN)
    first = window.times[drawn, window.start[drawn]]
    stamp_ns = int(np.sort(first)[(len(first) - 1) // 2])
    column = np.arange(window.times.shape[1])
    held = (column >= window.start[drawn, None]) & (column < window.stop[drawn, None])
    held &= window.times[drawn] <= stamp_ns
    return stamp_ns, window.positions[drawn, last_true(held)][held.any(1)]


def recognised(
    absent: Mapping[int, Record], newcomers: Mapping[int, Appearance | None], margin: float
) -> dict[int, int]:
    """Absent hypothesis that each new group is, {new: absent}, by place and extent.

    Parameters
    ----------
    absent
        Remembered hypotheses without a current member, by id.
    newcomers
        When and where new groups appeared, by id; None for a static one.
    margin
        By how much, in nat, a pair must be better than every assignment without it.
    """
    static = [number for number, record in absent.items() if record.static]
    # The static body is one, wherever it is seen: the last one known goes on.
    last = max(static, key=lambda number: absent[number].seen_ns, default=None)
    pairs = {new: last for new, first in newcomers.items() if first is None and last is not None}
    moving = {number: record for number, record in absent.items() if number not in static}
    groups = {new: first for new, first in newcomers.items() if first is not None}
    if moving and groups:
        usual = float(np.median([record.speed for record in moving.values()]))
        costs = [[_cost(record, *group, usual) for group in groups.values()] for record in moving.values()]
        clear = _clear_pairs(np.array(costs), margin)
        pairs |= {list(groups)[column]: list(moving)[row] for row, column in clear}
    return pairs


def _cost(record: Record, stamp_ns: int, positions: Floats, usual: float) -> float:
    """Negative log likelihood that a group is an absent body; infinite where it cannot be.

    A body moves at its own speed or the `usual` one, and about a place in the long run. Where a replay jumps,
    only the latter holds.
    """
    (centroid, extent), (where, size) = _place(record.positions), _place(positions)
    away = max((stamp_ns - record.seen_ns) * 1e-9, 0.0)
    stays = float(np.exp(-away / _BACK))
    way = _WAY_ERROR * max(record.speed, usual) * min(away, _BACK)
    own = (_CENTROID_ERROR * extent) ** 2
    predicted = record.place + stays * (centroid - record.place)
    costs = []
    for expected, variance, price in (
        (predicted, own + (1 - stays**2) * record.spread + way**2, 0.0),
        (record.place, own + record.spread, _JUMP),
    ):
        off = float(((where - expected) ** 2).sum() / variance) + (np.log(size / extent) / _EXTENT_ERROR) ** 2
        if off <= _GATE:
            costs.append(price + off / 2 + len(where) * float(np.log(variance)) / 2)
    return min(costs, default=np.inf)


def _clear_pairs(costs: Floats, margin: float) -> list[tuple[int, int]]:
    """Pairs of the best assignment that every assignment without them is worse than by a margin.

    `costs` float64 [n, m] are infinite for pairs that cannot be.
    """
    possible = np.isfinite(costs)
    if not possible.any():
        return []
    # As many pairs as can be are matched; what cannot be costs more than any difference among the others.
    worst = float(np.ptp(costs[possible])) * min(costs.shape) + 1e3
    filled = np.where(possible, costs - costs[possible].min(), worst)
    rows, columns = linear_sum_assignment(filled)
    best = filled[rows, columns].sum()
    pairs = []
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        without = filled.copy()
        without[row, column] = worst
        if possible[row, column] and without[linear_sum_assignment(without)].sum() - best >= margin:
            pairs.append((row, column))
    return pairs


def _place(positions: Floats) -> tuple[Floats, float]:
    """Centroid float64 [dim], and root mean square distance from it."""
    centroid = positions.mean(0)
    return centroid, float(np.sqrt(((positions - centroid) ** 2).sum(1).mean())) + 1e-9
