"""Remembers absent hypotheses, and recognises them by features, place and extent."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from comotion_schemas import Hypothesis

from ..arrays import Floats, Labels, Stamps, find
from ..partition import NO_HYPOTHESIS, PoseReference
from .appearance import Appearance

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


@dataclass
class Trace:
    """A hypothesis as it was last seen.

    Attributes
    ----------
    keys, stamps, positions
        int64 [m], int64 [m] and float64 [m, dim]: its last members, and when and where each was seen last.
    description
        As it was published last.
    static
        Whether it was the static body.
    reference
        Of its pose.
    place, spread
        float64 [dim], where its centroid has been in the mean of the last seconds; variance of a coordinate
        about it.
    """

    keys: Stamps
    stamps: Stamps
    positions: Floats
    description: Hypothesis
    static: bool
    reference: PoseReference
    place: Floats
    spread: float

    @property
    def stamp_ns(self) -> int:
        """When it was last seen."""
        return int(self.stamps.max())

    @property
    def velocity(self) -> Floats:
        """Of the centroid, float64 [dim]; zero where unknown."""
        twist = self.description.twist
        return np.zeros(self.positions.shape[1]) if twist is None else np.array(twist.linear)

    @property
    def brought_up(self) -> Floats:
        """Where its members were when it was last seen, float64 [m, dim]."""
        return np.asarray(self.positions + self.velocity * (self.stamp_ns - self.stamps)[:, None] * 1e-9)


@dataclass(frozen=True)
class Newcomer:
    """A group: keys int64 [n] and positions float64 [n, dim] of its current members.

    `static` says whether it is the method's static body.
    """

    keys: Stamps
    positions: Floats
    static: bool


class ObjectMemory:
    """The traces of all confirmed hypotheses of a space, by id."""

    def __init__(self) -> None:
        self.traces: dict[int, Trace] = {}

    def see(
        self,
        stamp_ns: int,
        group: Newcomer,
        current: Stamps,
        description: Hypothesis,
        reference: PoseReference,
    ) -> None:
        """Note a hypothesis with current members; `current` int64 [n], ascending, are all current keys."""
        keys, stamps = group.keys, np.full(len(group.keys), stamp_ns)
        positions, before = group.positions, self.traces.get(description.id)
        place, spread = positions.mean(0), 0.0
        if before is not None:
            place, spread = _followed(before, place, (stamp_ns - before.stamp_ns) * 1e-9)
            lost = (find(before.keys, current) < 0) & (before.stamps >= stamp_ns - int(_LAST_MEMBERS * 1e9))
            keys = np.concatenate([keys, before.keys[lost]])
            stamps = np.concatenate([stamps, before.stamps[lost]])
            positions = np.vstack([positions, before.positions[lost]])
        self.traces[description.id] = Trace(
            keys, stamps, positions, description, group.static, reference, place, spread
        )

    def heir(self, one: int, keys: Stamps, labels: Labels) -> int | None:
        """Hypothesis that most of the last members belong to now; None if more of them are lost.

        Parameters
        ----------
        one
            A remembered hypothesis.
        keys, labels
            int64 [n], the current trajectories, ascending, and their hypotheses.
        """
        at = find(self.traces[one].keys, keys)
        now = labels[at[at >= 0]]
        found, counts = np.unique(now[now != NO_HYPOTHESIS], return_counts=True)
        if not len(found) or 2 * counts.sum() <= len(self.traces[one].keys):
            return None
        return int(found[counts.argmax()])

    def recognised(
        self, absent: list[int], newcomers: Mapping[int, Appearance | None], margin: float
    ) -> dict[int, int]:
        """Absent hypothesis that each new group is, {new: absent}, by place, motion and extent.

        Parameters
        ----------
        absent
            Remembered hypotheses without a current member.
        newcomers
            When and where new groups appeared, by id; None for a static one.
        margin
            By how much, in nat, a pair must be better than every assignment without it.
        """
        found = {}
        static = [one for one in absent if self.traces[one].static]
        for new in (new for new, first in newcomers.items() if first is None):
            if static:
                # The static body is one, wherever it is seen: the last one known goes on.
                found[new] = max(static, key=lambda one: self.traces[one].stamp_ns)
        rows = [one for one in absent if one not in static]
        groups = {new: first for new, first in newcomers.items() if first is not None}
        if rows and groups:
            columns = list(groups)
            costs = self._costs(rows, list(groups.values()))
            found |= {columns[c]: rows[r] for r, c in clear_pairs(costs, margin)}
        return found

    def _costs(self, absent: list[int], groups: list[Appearance]) -> Floats:
        """Negative log likelihood of each pair, float64 [absent, groups]; infinite where it cannot be.

        A body keeps its velocity for a moment, and moves about a place in the long run. Where a replay jumps,
        only the latter holds.
        """
        traces = [self.traces[one] for one in absent]
        speeds = [float(np.linalg.norm(trace.velocity)) for trace in traces]
        usual = float(np.median(speeds))
        costs = np.full((len(absent), len(groups)), np.inf)
        for r, (trace, speed) in enumerate(zip(traces, speeds, strict=True)):
            for c, group in enumerate(groups):
                costs[r, c] = min(_continued(trace, group, max(speed, usual)), _jumped(trace, group))
        return costs

    def state(self) -> list[Any]:
        """As plain values and arrays."""
        return [
            [
                one,
                *(t.keys, t.stamps, t.positions, asdict(t.description), t.static, dict(vars(t.reference))),
                *(t.place, t.spread),
            ]
            for one, t in self.traces.items()
        ]

    def load(self, state: list[Any]) -> None:
        """Take up :meth:`state`."""
        self.traces = {
            int(one): Trace(
                keys,
                stamps,
                positions,
                Hypothesis(**values),
                bool(static),
                PoseReference(**ref),
                *_place_of(positions, more),
            )
            for one, keys, stamps, positions, values, static, ref, *more in state
        }


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


def _place_of(positions: Floats, saved: list[Any]) -> tuple[Floats, float]:
    """Place and spread as saved; states of former versions have none."""
    return (saved[0], float(saved[1])) if saved else (positions.mean(0), 0.0)


def _place(positions: Floats) -> tuple[Floats, float]:
    """Centroid float64 [dim], and root mean square distance from it."""
    centroid = positions.mean(0)
    return centroid, float(np.sqrt(((positions - centroid) ** 2).sum(1).mean())) + 1e-9
