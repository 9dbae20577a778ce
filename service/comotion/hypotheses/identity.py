"""Gives each group the id of the hypothesis that it continues: one memory of labels for all methods."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np

from comotion_schemas import UNDETERMINED

from ..arrays import Bools, Floats, Ints, Labels, Slots, distinct
from ..matching import continued
from ..partition import NO_HYPOTHESIS, Matching, Partition, PoseReference, Previous
from ..saving import NOT_KEPT
from ..trajectories.window import Window

# ns. A member for so long is established: it votes for its hypothesis as long again when it changes groups.
# After a gap in all data all may be one group at first, and two halves of a body that a wrong clock has split
# become one again feature by feature: neither shows whose id it is.
_TENURE_NS = 2_000_000_000
# Votes of an established member for the hypothesis in which it became one, and for that in which it is now;
# others have as many for the latter. The first part settles it, the second one keeps two halves from trading
# an id.
_ESTABLISHED_VOTES, _VOTES = 3, 1
# So many older ones must there be, as many as confirm a hypothesis by default.
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


@dataclass
class LabelMemory:
    """Hypotheses of groups and of all trajectories, and the birth of each hypothesis.

    Those of the trajectories are columns of the window.

    Attributes
    ----------
    allocator
        Where new hypotheses get their ids.
    established
        Whether members of long standing decide which hypothesis a group continues.
    ids
        int64 [K]: hypothesis of each group of the last partition.
    references
        By hypothesis that has a trajectory in the window.
    """

    allocator: IdAllocator = field(metadata=NOT_KEPT)
    established: bool = field(default=True, metadata=NOT_KEPT)
    ids: Labels = field(default_factory=lambda: np.zeros(0, np.int64))
    references: dict[int, PoseReference] = field(default_factory=dict)

    def previous(self, window: Window) -> Previous:
        """What a method learns of the last update."""
        return Previous(window.label, self.ids)

    def name(
        self, window: Window, partition: Partition, current: Slots, matching: Matching, stamp_ns: int
    ) -> Labels:
        """Hypotheses of the current trajectories, int64 [n]; a group that continues none gets a new id."""
        slots, groups = partition.slots, partition.groups
        known, before = window.label[slots], window.label[current]
        vote = partition.deciding & ~self._overruled(window, partition, current)
        # Whose the votes are does not matter in the method of the thesis.
        voters = window.source[slots[vote]] if self.established else None
        votes = Votes(supported(window, slots)[vote], known[vote], groups[vote], voters)
        self.ids = name_groups(votes, len(partition.described), matching, self.allocator.next)
        now = np.append(self.ids, NO_HYPOTHESIS)[groups]
        window.label[slots] = now
        window.label_ns[slots[now != known]] = stamp_ns
        _lead_outdated(window, slots, before, window.label[current])
        if self.established:
            _establish(window, slots, stamp_ns)
        return window.label[current]

    def _overruled(self, window: Window, partition: Partition, current: Slots) -> Bools:
        """Trajectories that have no say in which hypothesis a group continues, bool [N].

        These are late members, and trajectories out of sight, of a source without an established member,
        where those of others have enough: in the hypothesis, or in the group. So a crowd of a new source does
        not take the id of a body along.
        """
        slots, groups, sources = partition.slots, partition.groups, window.source[partition.slots]
        old = window.established[slots] != NO_HYPOTHESIS
        seen = np.isin(slots, current)
        if not self.established or (old & seen).all():
            return np.zeros(len(slots), np.bool_)
        deciding = old & seen & partition.deciding & (groups >= 0)
        late = ~old & _left_to_others(window.label[slots], sources, deciding)
        hidden = ~(old & seen) & (groups >= 0) & _left_to_others(groups, sources, deciding)
        return np.asarray(late | hidden)

    def rename(self, window: Window, names: dict[int, int]) -> None:
        """Give the members of some hypotheses other ids, {present: other}, all at once.

        Trajectories of the other ids that the method has kept apart from them have no hypothesis any more:
        one id would stand for two groups.
        """
        for array in (window.label, window.established, self.ids):
            before = array.copy()
            array[np.isin(before, list(names.values()))] = NO_HYPOTHESIS
            for present, other in names.items():
                array[before == present] = other

    def drop(self, window: Window, hypothesis: int) -> None:
        """Leave the members of a hypothesis without any."""
        for array in (window.label, window.established, self.ids):
            array[array == hypothesis] = NO_HYPOTHESIS

    def refer(self, window: Window, stamp_ns: int) -> None:
        """Forget the references of hypotheses without a trajectory or an established member in the window."""
        present, _ = distinct(np.concatenate([window.label[window.used], window.established[window.used]]))
        self.references = {
            h: self.references.get(h) or PoseReference.new(stamp_ns)
            for h in present.tolist()
            if h != NO_HYPOTHESIS
        }


@dataclass(frozen=True)
class Votes:
    """Of N trajectories: for which hypothesis each votes, which it is in, and its group; negative for none.

    int64 [N], int64 [N] and intp [N]; `sources` intp [N] says whose it is; None: each vote counts 1.
    """

    supported: Labels
    before: Labels
    groups: Ints
    sources: Slots | None = None

    def weights(self, wanted: Labels) -> Floats:
        """How much each vote for a hypothesis, int64 [N], counts, float64 [N].

        The votes of a source grow with the root of their number: what two sources see outweighs what a third
        sees otherwise with as many features as both. In the mean a vote for a hypothesis counts 1.
        """
        if self.sources is None:
            return np.ones(len(wanted))
        names, row = distinct(wanted)
        owners, column = distinct(self.sources)
        counts = np.bincount(row * len(owners) + column, minlength=len(names) * len(owners))
        roots = np.sqrt(counts.reshape(len(names), len(owners)))
        mean = (roots**2).sum(1) / np.maximum(roots.sum(1), 1.0)
        return np.asarray(mean[row] / roots[row, column])


def name_groups(votes: Votes, count: int, matching: Matching, allocate: Callable[[], int]) -> Labels:
    """Hypothesis of each group, int64 [count]; :data:`NO_HYPOTHESIS` for one without members.

    Parameters
    ----------
    votes
        Of the trajectories that decide.
    count
        Number of groups.
    matching
        Which old hypothesis continues in which group.
    allocate
        Gives a fresh id, for a group that continues none.
    """
    before, groups = np.concatenate([votes.supported, votes.before]), np.tile(votes.groups, 2)
    established, present = votes.weights(votes.supported), votes.weights(votes.before)
    weights = np.concatenate([_ESTABLISHED_VOTES * established, _VOTES * present])
    matched = continued(before, groups, count, matching, weights)
    ids = np.full(count, NO_HYPOTHESIS)
    for k in distinct(votes.groups[votes.groups >= 0])[0].tolist():
        ids[k] = matched[k] if k in matched else allocate()
    return ids


def _left_to_others(sets: Labels, sources: Slots, established: Bools) -> Bools:
    """Whose set has enough established members, none of its own source; bool [N], as all arguments are."""
    names, row = distinct(sets)
    owners, column = distinct(sources)
    cells = (row * len(owners) + column)[established]
    counts = np.bincount(cells, minlength=len(names) * len(owners)).reshape(len(names), len(owners))
    return np.asarray((counts.sum(1)[row] >= _ENOUGH_ESTABLISHED) & (counts[row, column] == 0))


def supported(window: Window, slots: Slots) -> Labels:
    """The hypotheses for which slots intp [n] vote, int64 [n]."""
    established = window.established[slots]
    return np.where(established == NO_HYPOTHESIS, window.label[slots], established)


def retire(window: Window, living: Collection[int]) -> None:
    """Nobody votes for any other hypothesis any more: an id that has ended does not come back."""
    window.established[~np.isin(window.established, list(living))] = NO_HYPOTHESIS


def _establish(window: Window, slots: Slots, stamp_ns: int) -> None:
    """Establish slots whose label has lasted, and that the window knows for as long."""
    slots = slots[window.stop[slots] > window.start[slots]]
    since_ns = np.maximum(window.label_ns[slots], window.times[slots, window.start[slots]])
    settled = slots[since_ns <= stamp_ns - min(_TENURE_NS, window.span_ns // 2)]
    window.established[settled] = window.label[settled]


def _lead_outdated(window: Window, named: Slots, before: Labels, now: Labels) -> None:
    """Let outdated trajectories follow the current ones, which went from `before` to `now`, int64 [n].

    They keep their label for their return. Only where a hypothesis has no current member left, and more
    of its members have just gone over to another than are outdated, they go with them.
    """
    outdated = window.used & ~window.ended
    outdated[named] = False
    for label in np.setdiff1d(before[before != now], np.append(now, NO_HYPOTHESIS)).tolist():
        went, votes = np.unique(now[before == label], return_counts=True)
        members = outdated & (window.label == label)
        if votes.max() > np.count_nonzero(members):
            window.label[members] = went[votes.argmax()]
