"""Gives each group the id of the hypothesis that it continues: one memory of labels for all methods.

A new group may be a hypothesis that has no current member: place and extent tell.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment

from comotion_schemas import UNDETERMINED

from ..arrays import Bools, Floats, Ints, Labels, Slots, distinct, last_true, thinned
from ..matching import continued, largest_first, largest_total
from ..partition import NO_HYPOTHESIS, Partition
from ..trajectories.window import Window
from .records import MEMBERS, Record

# ns. A member for so long is established: it votes for its hypothesis as long again when it changes groups.
# After a gap in all data all may be one group at first, and two halves of a body that a wrong clock has split
# become one again feature by feature: neither shows whose id it is.
_TENURE_NS = 2_000_000_000
# Votes of an established member for the hypothesis in which it became one, and for that in which it is now;
# others have as many for the latter. The first part settles it, the second one keeps two halves from trading
# an id.
_ESTABLISHED_VOTES, _VOTES = 3, 1
# A crash may come after ids were given out that nobody else has seen; ids are never reused.
ID_GAP = 1000
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


@dataclass
class IdAllocator:
    """Hands out hypothesis ids, never the same twice within a scene."""

    following: int = 1

    def next(self) -> int:
        """A fresh id."""
        if self.following >= UNDETERMINED:
            raise OverflowError("out of hypothesis ids")
        self.following += 1
        return self.following - 1


def named(
    window: Window,
    partition: Partition,
    current: Slots,
    allocate: Callable[[], int],
    stamp_ns: int,
    rested: list[int],
    *,
    by_thesis: bool,
) -> Labels:
    """Hypothesis of each group, int64 [K]; one that continues none gets a new id, one without members none.

    The hypotheses of all trajectories, columns of the window, are brought up to date. With `by_thesis` all
    members alike decide which hypothesis a group continues, by label propagation; else those of long standing
    do, and sources that agree, in the best assignment. What rests keeps the hypothesis that has `rested`,
    however much of it moves away.
    """
    slots, groups, vote = partition.slots, partition.groups, partition.deciding
    # Whose the votes are does not matter in the method of the thesis.
    _, sources = distinct(window.source[slots] * (not by_thesis))
    if not by_thesis:
        vote = vote & ~_overruled(window, partition, current, sources)
    last, voters, sources = window.label[slots], groups[vote], sources[vote]
    votes = supported(window, slots)[vote], last[vote]
    weights = [_ESTABLISHED_VOTES * balanced(votes[0], sources), _VOTES * balanced(votes[1], sources)]
    rests = np.array([*(group.static for group in partition.described), False])[voters]
    for (weight, names), hypothesis in product(zip(weights, votes, strict=True), rested):
        held = names == hypothesis
        if (held & rests).any():
            weight[held & ~rests] = 0.0
    count = len(partition.described)
    matching = largest_first if by_thesis else largest_total
    matched = continued(np.concatenate(votes), np.tile(voters, 2), count, matching, np.concatenate(weights))
    ids = np.full(count, NO_HYPOTHESIS)
    for k in np.flatnonzero(np.bincount(voters[voters >= 0])).tolist():
        ids[k] = matched[k] if k in matched else allocate()
    labels = np.append(ids, NO_HYPOTHESIS)[groups]
    window.label[slots] = labels
    window.label_ns[slots[labels != last]] = stamp_ns
    if not by_thesis:
        # Those whose label has lasted are established, where the window knows them for as long.
        held = slots[window.stop[slots] > window.start[slots]]
        since_ns = np.maximum(window.label_ns[held], window.times[held, window.start[held]])
        settled = held[since_ns <= stamp_ns - min(_TENURE_NS, window.span_ns // 2)]
        window.established[settled] = window.label[settled]
    return ids


def _overruled(window: Window, partition: Partition, current: Slots, sources: Ints) -> Bools:
    """Members that have no say in which hypothesis a group continues, bool [N], by sources intp [N].

    Current established members of the hypothesis are enough, and these are not current, so that nothing new
    is known of them, or new of a source that has none of those. So neither a crowd of a new source takes the
    id of a body along, nor what is left of a source that has gone.
    """
    established = window.established[partition.slots] != NO_HYPOTHESIS
    seen = np.bincount(current, minlength=window.capacity)[partition.slots] > 0
    deciding = established & seen & partition.deciding & (partition.groups >= 0)
    row, counts = _counts(window.label[partition.slots], sources, deciding)
    new = ~established & (counts[row, sources] == 0)
    return np.asarray((counts.sum(1)[row] >= MEMBERS) & (~seen | new))


def balanced(labels: Labels, sources: Ints) -> Floats:
    """How much each vote for a hypothesis, int64 [N], counts, float64 [N], by the sources intp [N] from 0.

    The votes of a source grow with the root of their number: what two sources see outweighs what a third sees
    otherwise with as many features as both. In the mean a vote for a hypothesis counts 1.
    """
    row, counts = _counts(labels, sources)
    roots = np.sqrt(counts)
    mean = (roots**2).sum(1) / np.maximum(roots.sum(1), 1.0)
    return np.asarray(mean[row] / roots[row, sources])


def _counts(sets: Labels, sources: Ints, counted: Bools | slice = slice(None)) -> tuple[Ints, Ints]:
    """Row of each set [N] in a table, and the table: how many of it are of each source, those `counted`."""
    names, row = distinct(sets)
    width = int(sources.max(initial=0)) + 1
    counts = np.bincount((row * width + sources)[counted], minlength=len(names) * width)
    return row, counts.reshape(-1, width)


def supported(window: Window, slots: Slots) -> Labels:
    """The hypotheses for which slots intp [n] vote, int64 [n]."""
    established = window.established[slots]
    return np.where(established == NO_HYPOTHESIS, window.label[slots], established)


def relabel(columns: Iterable[Labels], names: Mapping[int, int]) -> None:
    """Give the members of some hypotheses other ids, {present: other}, all at once, in columns int64 [n].

    Trajectories of the other ids that the method has kept apart from them have no hypothesis any more: one id
    would stand for two groups.
    """
    for column in columns if names else ():
        labels = column.copy()
        column[np.isin(labels, list(names.values()))] = NO_HYPOTHESIS
        for present, other in names.items():
            column[labels == present] = other


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

    Both are by id; of a new group it is known when and where it appeared, None for a static one. A pair must
    be better than every assignment without it by a margin in nat.
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
