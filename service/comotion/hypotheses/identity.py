"""Gives each group the id of the hypothesis that it continues: one memory of labels for all methods."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from comotion_schemas import UNDETERMINED

from ..arrays import Bools, Floats, Ints, Labels, Slots, Stamps, distinct, find
from ..matching import continued
from ..partition import NO_HYPOTHESIS, Matching, Partition, PoseReference, Previous
from ..saving import plain, restored
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
_LONG_AGO_NS = -(2**62)
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


class LabelMemory:
    """Hypotheses of all slots of a window, and the birth of each hypothesis.

    Parameters
    ----------
    ids
        Where new hypotheses get their ids.
    established
        Whether members of long standing decide which hypothesis a group continues.

    Attributes
    ----------
    labels
        int64 [capacity]: hypothesis of each slot, or :data:`NO_HYPOTHESIS`.
    ids
        int64 [K]: hypothesis of each group of the last partition.
    references
        By hypothesis that has a trajectory in the window.
    """

    def __init__(self, ids: IdAllocator, *, established: bool = True) -> None:
        self._allocator = ids
        self._established_decide = established
        self.labels: Labels = np.zeros(0, np.int64)
        # When each slot got its label, ns.
        self._since: Stamps = np.zeros(0, np.int64)
        # In which hypothesis each slot became an established member, negative for none.
        self._established_in: Labels = np.zeros(0, np.int64)
        self.ids: Labels = np.zeros(0, np.int64)
        self.references: dict[int, PoseReference] = {}

    def previous(self, window: Window) -> Previous:
        """What a method learns of the last update."""
        self._fit(window)
        return Previous(self.labels, self.ids)

    def forget(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""
        self._fit(window)
        self.labels[slots] = self._established_in[slots] = NO_HYPOTHESIS

    def supported(self, slots: Slots) -> Labels:
        """The hypotheses for which slots intp [n] vote, int64 [n]."""
        established_in = self._established_in[slots]
        return np.where(established_in == NO_HYPOTHESIS, self.labels[slots], established_in)

    def name(
        self, window: Window, partition: Partition, current: Slots, matching: Matching, stamp_ns: int
    ) -> Labels:
        """Hypotheses of the current trajectories, int64 [n]; a group that continues none gets a new id."""
        self._fit(window)
        slots, groups = partition.slots, partition.groups
        known, before = self.labels[slots], self.labels[current]
        seen = np.zeros(window.capacity, np.bool_)
        seen[current] = True
        if self._continues(partition, seen[slots], known):
            held = np.isin(np.arange(len(self.ids)), groups)
            self.ids = np.where(held, self.ids, NO_HYPOTHESIS)
        else:
            self._vote(window, partition, seen[slots], known, matching)
        now = np.append(self.ids, NO_HYPOTHESIS)[groups]
        self.labels[slots] = now
        self._since[slots[now != known]] = stamp_ns
        self._lead_outdated(window, slots, before, self.labels[current])
        if self._established_decide:
            self._establish(window, slots, stamp_ns)
        return self.labels[current]

    def _continues(self, partition: Partition, seen: Bools, known: Labels) -> bool:
        """Whether the groups are those of the last update, so that a vote would change nothing.

        Nobody has gone from one to another, and each has a member whose vote counts.
        """
        groups, count = partition.groups, len(partition.described)
        if len(self.ids) != count:
            return False
        now = np.append(self.ids, NO_HYPOTHESIS)[groups]
        old = self._established_in[partition.slots]
        strange = ((known != now) & (known >= 0)) | ((old != now) & (old >= 0))
        voting = np.zeros(count + 1, np.bool_)
        voting[groups[seen & partition.deciding & (old >= 0)]] = True
        holding = np.zeros(count + 1, np.bool_)
        holding[groups] = True
        return not strange.any() and bool((holding[:-1] == voting[:-1]).all())

    def _vote(
        self, window: Window, partition: Partition, seen: Bools, known: Labels, matching: Matching
    ) -> None:
        """Let the members decide which hypothesis each group continues."""
        slots, groups = partition.slots, partition.groups
        vote = partition.deciding & ~self._overruled(window, partition, seen)
        # Whose the votes are does not matter in the method of the thesis.
        voters = window.source[slots[vote]] if self._established_decide else None
        votes = Votes(self.supported(slots)[vote], known[vote], groups[vote], voters)
        self.ids = name_groups(votes, len(partition.described), matching, self._allocator.next)

    def _establish(self, window: Window, slots: Slots, stamp_ns: int) -> None:
        """Establish slots whose label has lasted, and that the window knows for as long."""
        tenure_ns = min(_TENURE_NS, window.span_ns // 2)
        held = window.stop[slots] > window.start[slots]
        first_ns = window.times[slots, np.minimum(window.start[slots], window.times.shape[1] - 1)]
        since_ns = np.maximum(self._since[slots], first_ns)
        settled = slots[held & (since_ns <= stamp_ns - tenure_ns)]
        self._established_in[settled] = self.labels[settled]

    def _overruled(self, window: Window, partition: Partition, seen: Bools) -> Bools:
        """Trajectories that have no say in which hypothesis a group continues, bool [N].

        These are late members, and trajectories out of sight, of a source without an established member,
        where those of others have enough: in the hypothesis, or in the group. So a crowd of a new source does
        not take the id of a body along.
        """
        slots, groups = partition.slots, partition.groups
        known, old = self.labels[slots], self._established_in[slots] != NO_HYPOTHESIS
        sources = window.source[slots]
        if not self._established_decide or (old & seen).all():
            return np.zeros(len(slots), np.bool_)
        established = old & seen & partition.deciding & (groups >= 0)
        late = ~old & _left_to_others(known, sources, established)
        return np.asarray(
            late | (~(old & seen) & (groups >= 0) & _left_to_others(groups, sources, established))
        )

    def rename(self, names: dict[int, int]) -> None:
        """Give the members of some hypotheses other ids, {present: other}, all at once.

        Trajectories of the other ids that the method has kept apart from them have no hypothesis any more:
        one id would stand for two groups.
        """
        for array in (self.labels, self._established_in, self.ids):
            before = array.copy()
            array[np.isin(before, list(names.values()))] = NO_HYPOTHESIS
            for present, other in names.items():
                array[before == present] = other

    def retire(self, living: Collection[int]) -> None:
        """Nobody votes for any other hypothesis any more: an id that has ended does not come back."""
        voting = self._established_in != NO_HYPOTHESIS
        self._established_in[voting & ~np.isin(self._established_in, list(living))] = NO_HYPOTHESIS

    def drop(self, hypothesis: int) -> None:
        """Leave the members of a hypothesis without any."""
        self.labels[self.labels == hypothesis] = NO_HYPOTHESIS
        self._established_in[self._established_in == hypothesis] = NO_HYPOTHESIS
        self.ids[self.ids == hypothesis] = NO_HYPOTHESIS

    def refer(self, window: Window, stamp_ns: int) -> None:
        """Forget the references of hypotheses without a trajectory or an established member in the window."""
        present, _ = distinct(np.concatenate([self.labels[window.used], self._established_in[window.used]]))
        self.references = {
            h: self.references.get(h) or PoseReference.new(stamp_ns)
            for h in present.tolist()
            if h != NO_HYPOTHESIS
        }

    def state(self, window: Window) -> dict[str, Any]:
        """As plain values and arrays: labels by trajectory, births by hypothesis."""
        self._fit(window)
        slots = window.slots()
        return {
            "tracks": window.key[slots],
            "labels": self.labels[slots],
            "established": self._established_in[slots],
            "ids": self.ids.copy(),
            "references": plain(self.references),
        }

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; an empty one says nothing."""
        self._fit(window)
        if not state:
            return
        slots = window.slots()
        rows = find(window.key[slots], state["tracks"])
        self.labels[slots] = np.append(state["labels"], NO_HYPOTHESIS)[rows]
        if self._established_decide:
            self._established_in[slots] = np.append(state["established"], NO_HYPOTHESIS)[rows]
        self.ids = state["ids"]
        self.references = restored(dict[int, PoseReference], state["references"])

    def _fit(self, window: Window) -> None:
        """Hold every slot of the window."""
        extra = window.capacity - len(self.labels)
        if extra:
            self.labels = np.pad(self.labels, (0, extra), constant_values=NO_HYPOTHESIS)
            self._since = np.pad(self._since, (0, extra), constant_values=_LONG_AGO_NS)
            self._established_in = np.pad(self._established_in, (0, extra), constant_values=NO_HYPOTHESIS)

    def _lead_outdated(self, window: Window, named: Slots, before: Labels, now: Labels) -> None:
        """Let outdated trajectories follow the current ones, which went from `before` to `now`."""
        if not ((before != now) & (before != NO_HYPOTHESIS)).any():
            return
        outdated = window.used & ~window.ended
        outdated[named] = False
        slots = np.flatnonzero(outdated)
        self.labels[slots] = follow(before, now, self.labels[slots])


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


def follow(before: Labels, now: Labels, outdated: Labels) -> Labels:
    """Labels of outdated trajectories, after the current ones went from `before` to `now`.

    They keep their label for their return. Only where a hypothesis has no current member left, and more
    of its members have just gone over to another than are outdated, they go with them.

    Parameters
    ----------
    before, now
        int64 [n], of the current trajectories.
    outdated
        int64 [m], of the outdated ones.
    """
    followed = outdated.copy()
    for label in np.unique(outdated):
        if (now == label).any():
            continue
        went, votes = np.unique(now[before == label], return_counts=True)
        members = outdated == label
        if label != NO_HYPOTHESIS and votes.max(initial=0) > members.sum():
            followed[members] = went[votes.argmax()]
    return followed
