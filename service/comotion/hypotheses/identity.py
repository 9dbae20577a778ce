"""Gives each group the id of the hypothesis that it continues: one memory of labels for all methods."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from comotion_schemas import UNDETERMINED

from ..arrays import Bools, Floats, Labels, Slots, distinct
from ..matching import continued
from ..partition import NO_HYPOTHESIS, Matching, Partition
from ..trajectories.window import Window

# ns. A member for so long is established: it votes for its hypothesis as long again when it changes groups.
# After a gap in all data all may be one group at first, and two halves of a body that a wrong clock has split
# become one again feature by feature: neither shows whose id it is.
_TENURE_NS = 2_000_000_000
# Votes of an established member for the hypothesis in which it became one, and for that in which it is now;
# others have as many for the latter. The first part settles it, the second one keeps two halves from trading
# an id.
_ESTABLISHED_VOTES, _VOTES = 3, 1
# So many established members of other sources must there be, as many as confirm a hypothesis by default.
_ENOUGH_ESTABLISHED = 3
# A crash may come after ids were given out that nobody else has seen; ids are never reused.
ID_GAP = 1000


@dataclass
class IdAllocator:
    """Hands out hypothesis ids, never the same twice within a scene."""

    following: int = 1

    def next(self) -> int:
        """A fresh id.

        Raises
        ------
        OverflowError
            After 2**32 - 2 hypotheses.
        """
        if self.following >= UNDETERMINED:
            raise OverflowError("out of hypothesis ids")
        self.following += 1
        return self.following - 1


def named(
    window: Window,
    partition: Partition,
    current: Slots,
    matching: Matching,
    allocate: Callable[[], int],
    stamp_ns: int,
    *,
    established: bool,
) -> Labels:
    """Hypothesis of each group, int64 [K]; one that continues none gets a new id, one without members none.

    The hypotheses of all trajectories, columns of the window, are brought up to date.

    Parameters
    ----------
    window, partition, current
        The trajectories, their groups, and intp [n] those that go on.
    matching
        Which old hypothesis continues in which group.
    allocate
        Gives a fresh id.
    stamp_ns
        The watermark.
    established
        Whether members of long standing decide which hypothesis a group continues, and sources that agree.
    """
    slots, groups, vote = partition.slots, partition.groups, partition.deciding
    if established:
        vote = vote & ~_overruled(window, partition, current)
    last, voters = window.label[slots], groups[vote]
    # Whose the votes are does not matter in the method of the thesis.
    sources = window.source[slots[vote]] * established
    votes = supported(window, slots)[vote], last[vote]
    weights = [_ESTABLISHED_VOTES * balanced(votes[0], sources), _VOTES * balanced(votes[1], sources)]
    count = len(partition.described)
    matched = continued(np.concatenate(votes), np.tile(voters, 2), count, matching, np.concatenate(weights))
    ids = np.full(count, NO_HYPOTHESIS)
    for k in distinct(voters[voters >= 0])[0].tolist():
        ids[k] = matched[k] if k in matched else allocate()
    now = np.append(ids, NO_HYPOTHESIS)[groups]
    window.label[slots] = now
    window.label_ns[slots[now != last]] = stamp_ns
    if established:
        _establish(window, slots, stamp_ns)
    return ids


def _overruled(window: Window, partition: Partition, current: Slots) -> Bools:
    """Trajectories that have no say in which hypothesis a group continues, bool [N].

    These are late members, and trajectories out of sight, of a source without an established member, where
    those of others are enough: in the hypothesis, or in the group. So a crowd of a new source does not take
    the id of a body along.
    """
    slots, groups, sources = partition.slots, partition.groups, window.source[partition.slots]
    old, seen = window.established[slots] != NO_HYPOTHESIS, np.isin(slots, current)
    deciding = old & seen & partition.deciding & (groups >= 0)
    late = ~old & _left_to_others(window.label[slots], sources, deciding)
    return np.asarray(late | (~(old & seen) & (groups >= 0) & _left_to_others(groups, sources, deciding)))


def _left_to_others(sets: Labels, sources: Slots, established: Bools) -> Bools:
    """Whose set has enough established members, none of its own source; bool [N], as all arguments are."""
    names, row = distinct(sets)
    owners, column = distinct(sources)
    cells = (row * len(owners) + column)[established]
    counts = np.bincount(cells, minlength=len(names) * len(owners)).reshape(len(names), len(owners))
    return np.asarray((counts.sum(1)[row] >= _ENOUGH_ESTABLISHED) & (counts[row, column] == 0))


def balanced(labels: Labels, sources: Slots) -> Floats:
    """How much each vote for a hypothesis, int64 [N], counts, float64 [N], by the sources intp [N].

    The votes of a source grow with the root of their number: what two sources see outweighs what a third sees
    otherwise with as many features as both. In the mean a vote for a hypothesis counts 1.
    """
    names, row = distinct(labels)
    owners, column = distinct(sources)
    counts = np.bincount(row * len(owners) + column, minlength=len(names) * len(owners))
    roots = np.sqrt(counts.reshape(len(names), len(owners)))
    mean = (roots**2).sum(1) / np.maximum(roots.sum(1), 1.0)
    return np.asarray(mean[row] / roots[row, column])


def supported(window: Window, slots: Slots) -> Labels:
    """The hypotheses for which slots intp [n] vote, int64 [n]."""
    established = window.established[slots]
    return np.where(established == NO_HYPOTHESIS, window.label[slots], established)


def _establish(window: Window, slots: Slots, stamp_ns: int) -> None:
    """Establish slots intp [n] whose label has lasted, and that the window knows for as long."""
    slots = slots[window.stop[slots] > window.start[slots]]
    since_ns = np.maximum(window.label_ns[slots], window.times[slots, window.start[slots]])
    settled = slots[since_ns <= stamp_ns - min(_TENURE_NS, window.span_ns // 2)]
    window.established[settled] = window.label[settled]


def relabel(columns: Iterable[Labels], names: Mapping[int, int]) -> None:
    """Give the members of some hypotheses other ids, {present: other}, all at once, in columns int64 [n].

    Trajectories of the other ids that the method has kept apart from them have no hypothesis any more: one id
    would stand for two groups.
    """
    for column in columns:
        labels = column.copy()
        column[np.isin(labels, list(names.values()))] = NO_HYPOTHESIS
        for present, other in names.items():
            column[labels == present] = other
