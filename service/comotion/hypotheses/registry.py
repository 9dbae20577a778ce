"""Identity, confirmation and memory of the hypotheses of one space.

The steps of an update:

1. Name the groups: those that share members with a hypothesis continue it (:mod:`.identity`).
2. Recall: a new group that is a remembered hypothesis takes its id (:mod:`.memory`).
3. Confirm hypotheses and find the events (:mod:`.events`).
4. Describe those with current members, measure them (:mod:`.extent`), and list the absent ones.

What is known of each is one record (:mod:`.records`).
"""

from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from comotion_schemas import Event, Hypothesis

from ..arrays import Labels, Slots
from ..config import HypothesesConfig
from ..partition import NO_HYPOTHESIS, Matching, Partition, PoseReference, Previous
from ..saving import plain, refill
from ..trajectories.window import Window
from .events import Lifecycle
from .extent import box_of
from .identity import IdAllocator, named, relabel, supported
from .memory import appearance, recognised
from .records import Current, Record

# nat; how clearly a new group must be a remembered hypothesis to take its id at once, and at the last moment
# before it is confirmed under its own: then the best assignment of all groups decides. With true
# groups of four bodies that turn back after some seconds, nine in ten are right after 3 s out of sight.
_CLEAR, _LIKELY = 2.0, 0.0
# Smallest space in which hypotheses of two members are not confirmed, in members that confirm one.
_BODIES = 2
# Confidence from which a feature counts for the extent of its hypothesis.
_SURE = 0.5


class Registry:
    """Hypotheses of one space over time.

    Parameters
    ----------
    space
        Its name.
    allocator
        Where new hypotheses get their ids.
    config
        Of confirmation and memory.
    established
        Whether members of long standing decide which hypothesis a group continues.

    Attributes
    ----------
    ids
        int64 [K]: hypothesis of each group of the last partition.
    """

    def __init__(
        self, space: str, allocator: IdAllocator, config: HypothesesConfig, *, established: bool = True
    ) -> None:
        self._space, self._allocator, self._config = space, allocator, config
        self._established = established
        self._lifecycle = Lifecycle(config)
        self.ids: Labels = np.zeros(0, np.int64)

    @property
    def _records(self) -> dict[int, Record]:
        return self._lifecycle.records

    @property
    def references(self) -> dict[int, PoseReference]:
        """Birth and pose of each hypothesis."""
        return {one: record.reference for one, record in self._records.items()}

    def previous(self, window: Window) -> Previous:
        """What a method learns of the last update."""
        return Previous(window.label, self.ids)

    def update(
        self,
        window: Window,
        partition: Partition,
        current: Slots,
        stamp_ns: int,
        matching: Matching,
        *,
        boxes: bool = True,
    ) -> tuple[Labels, list[Hypothesis], list[Event]]:
        """Follow the hypotheses into a new partition.

        Parameters
        ----------
        window, partition
            The trajectories, and their groups.
        current
            intp [n], the current slots, by age.
        stamp_ns
            The watermark.
        matching
            Which old hypothesis continues in which group.
        boxes
            Whether the axes of boxes may be sought.

        Returns
        -------
        tuple
            Hypotheses of the current trajectories, int64 [n], negative for none; all hypotheses, by id;
            the events of this update.
        """
        before = window.label[current]
        terms = current, matching, self._allocator.next, stamp_ns
        self.ids = named(window, partition, *terms, established=self._established)  # 1
        sure = partition.confidence >= _SURE
        found = Current(window.key[current], current, window.label[current], partition.position, sure)
        if self._recall(stamp_ns, window, partition, found):  # 2
            found = replace(found, labels=window.label[current])
        members = found.members
        origins = {one: _origin(before[rows]) for one, rows in members.items() if one not in self._records}
        heirs = self._heirs(found, supported(window, current))
        sizes = {one: len(rows) for one, rows in members.items()}
        events = self._lifecycle.advance(stamp_ns, sizes, self._least(found), origins, heirs)  # 3
        # Nobody votes for any other hypothesis any more: an id that has ended does not come back, nor with
        # features that are out of sight.
        window.established[~np.isin(window.established, list(self._records))] = NO_HYPOTHESIS
        ends = [event.others or [event.hypothesis] for event in events if event.kind in ("merged", "ended")]
        relabel((window.label, self.ids), dict.fromkeys(chain(*ends), NO_HYPOTHESIS))
        listed = [*self._described(stamp_ns, partition, found, boxes), *self._absent(found)]  # 4
        return found.labels, sorted(listed, key=lambda h: h.id), events

    def forget(self, window: Window, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all: its members are grouped as new ones. Returns those forgotten."""
        gone = sorted(one for one in self._records if hypothesis in (None, one))
        for one in gone:
            self._lifecycle.forget(one)
        relabel((window.label, window.established, self.ids), dict.fromkeys(gone, NO_HYPOTHESIS))
        return gone

    def state(self) -> dict[str, Any]:
        """As plain values and arrays, beside the columns of the window."""
        return {"ids": self.ids.copy(), "lives": plain(self._lifecycle)}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; an empty one: start afresh on the trajectories of the window."""
        if state:
            self.ids = state["ids"]
            refill(self._lifecycle, state["lives"])
        else:
            window.label[:] = window.established[:] = NO_HYPOTHESIS

    def _remembered(self, found: Current) -> dict[int, Record]:
        """What is known of the confirmed hypotheses without a current member, by id."""
        return {
            one: record
            for one, record in self._records.items()
            if record.description is not None and one not in found.members
        }

    def _least(self, found: Current) -> int:
        """Current members that confirm a hypothesis."""
        return self._config.members if len(found.keys) >= _BODIES * self._config.members else 2

    def _recall(self, stamp_ns: int, window: Window, partition: Partition, found: Current) -> bool:
        """Give new groups the ids of the remembered hypotheses that they are; returns whether any is."""
        members, least, missing = found.members, self._least(found), self._remembered(found)
        groups = [
            one
            for one, rows in members.items()
            if missing and len(rows) >= least and not self._lifecycle.confirmed(one)
        ]
        if not groups:
            return False
        static = self._static(partition)
        heirs = self._heirs(found, found.labels)
        names = {heir: one for one, heir in heirs.items() if heir in groups and heir != static}
        lost = [one for one in missing if heirs[one] is None]
        due = [one for one in groups if self._lifecycle.due(one, stamp_ns)]
        first = {
            one: None if one == static else appearance(window, found.slots[members[one]]) for one in groups
        }
        for some, margin in ((groups, _CLEAR), (due, _LIKELY)):
            left = {new: seen for new, seen in first.items() if new not in names}
            free = {one: missing[one] for one in lost if one not in names.values()}
            names |= {new: old for new, old in recognised(free, left, margin).items() if new in some}
        relabel((window.label, window.established, self.ids), names)
        for new, old in names.items():
            missing[old].move(None if new == static else found.centroid(new), stamp_ns)
        return bool(names)

    def _static(self, partition: Partition) -> int | None:
        """The hypothesis of the static body, if there is one."""
        groups = zip(self.ids.tolist(), partition.described, strict=False)
        return next((one for one, group in groups if group.static), None)

    def _heirs(self, found: Current, labels: Labels) -> dict[int, int | None]:
        """The hypothesis, by labels int64 [n], in which most of the last members of a remembered one are."""
        return {one: record.heir(found.keys, labels) for one, record in self._remembered(found).items()}

    def _described(
        self, stamp_ns: int, partition: Partition, found: Current, boxes: bool
    ) -> list[Hypothesis]:
        """Hypotheses that have a current member, measured and described, with their records up to date."""
        listed = []
        for group, one in zip(partition.described, self.ids.tolist(), strict=True):
            record = self._records.get(one)
            if record is None:
                continue
            # A hypothesis without a current member keeps its pose up to date for their return.
            pose = None if group.pose_since is None else group.pose_since(record.reference)
            if one not in found.members:
                continue
            record.see(stamp_ns, one, found, posed=pose is not None)
            record.static = group.static
            described = Hypothesis(
                id=one,
                space=self._space,
                size=len(found.members[one]),
                born_ns=record.reference.born_ns,
                state=group.state,
                centroid=found.centroid(one).tolist(),
                pose=pose,
                twist=group.twist,
                noise=group.noise,
                confirmed=self._lifecycle.confirmed(one),
                box=box_of(record, seek=boxes),
            )
            record.description = described if described.confirmed else None
            listed.append(described)
        return listed

    def _absent(self, found: Current) -> list[Hypothesis]:
        """Hypotheses that are remembered without a current member, as they were last seen."""
        return [
            replace(record.description, size=0, absent=True, confirmed=True)
            for record in self._remembered(found).values()
            if record.description is not None and record.heir(found.keys, found.labels) is None
        ]


def _origin(before: Labels) -> int | None:
    """The hypothesis that most members were of; None where more were of none."""
    found, counts = np.unique(before[before != NO_HYPOTHESIS], return_counts=True)
    if not len(found) or 2 * counts.sum() < len(before):
        return None
    return int(found[counts.argmax()])
