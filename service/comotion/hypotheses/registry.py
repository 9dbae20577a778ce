"""Identity, confirmation and memory of the hypotheses of one space.

The steps of an update:

1. Name the groups: those that share members with a hypothesis continue it (:mod:`.identity`).
2. Recall: a new group that is a remembered hypothesis takes its id.
3. Confirm hypotheses and find the events.
4. Describe those with current members, measure them (:mod:`.extent`), and list the absent ones.

What is known of each is one record (:mod:`.records`).

A hypothesis is unconfirmed, present or absent. Each change must last for `confirm` seconds until it counts:

    unconfirmed -> present   it has enough members             born, or split
    present -> absent        it has no current member          absent
    present -> gone          its members are another's now     merged
    absent -> present        it has enough members again       returned
    absent -> gone           too long ago, or too many         ended

What reverts earlier makes no event. An unconfirmed hypothesis without current members vanishes silently.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from comotion_schemas import Event, Hypothesis
from comotion_schemas.hypotheses import EventKind

from ..arrays import Labels, Slots, find
from ..config import HypothesesConfig, to_ns
from ..partition import NO_HYPOTHESIS, Partition, PoseReference
from ..saving import NOT_KEPT
from ..trajectories.window import Window
from .extent import box_of
from .identity import IdAllocator, appearance, named, recognised, relabel, supported
from .records import MEMBERS, NEVER_NS, Current, Record, majority

# "Those of the last 2 s" of docs/protocol.md.
EVENT_MEMORY_NS = 2_000_000_000
# Hypotheses without current members that are remembered in a space.
_REMEMBERED = 32
_ORDER: list[EventKind] = ["born", "split", "returned", "merged", "absent", "ended"]
# Kind, hypothesis and others of an event.
_Change = tuple[EventKind, int, list[int]]
# nat; how clearly a new group must be a remembered hypothesis to take its id at once, and at the last moment
# before it is confirmed under its own: then the best assignment of all groups decides. With true
# groups of four bodies that turn back after some seconds, nine in ten are right after 3 s out of sight.
_CLEAR, _LIKELY = 2.0, 0.0
# Smallest space in which hypotheses of two members are not confirmed, in members that confirm one.
_BODIES = 2
# Confidence from which a feature counts for the extent of its hypothesis.
_SURE = 0.5


@dataclass
class Registry:
    """Hypotheses of one space over time, and the state machine of their events."""

    config: HypothesesConfig = field(metadata=NOT_KEPT)
    """Times of confirmation and memory."""
    space: str = field(metadata=NOT_KEPT)
    """Its name."""
    allocator: IdAllocator = field(metadata=NOT_KEPT)
    """Where new hypotheses get their ids."""
    by_thesis: bool = field(default=False, metadata=NOT_KEPT)
    """Whether all members alike decide which hypothesis a group continues."""
    records: dict[int, Record] = field(default_factory=dict)
    """What is known of each hypothesis, by id."""
    _stamp_ns: int | None = None
    _forgotten: list[int] = field(default_factory=list)
    ids: Labels = field(default_factory=lambda: np.zeros(0, np.int64))
    """int64 [K]: hypothesis of each group of the last partition."""

    def __post_init__(self) -> None:
        self._confirm_ns = to_ns(self.config.confirm)

    def update(
        self,
        window: Window,
        partition: Partition,
        current: Slots,
        stamp_ns: int,
        *,
        boxes: bool = True,
    ) -> tuple[Labels, list[Hypothesis], list[Event]]:
        """Follow the hypotheses into a new partition of the current slots intp [n], by age.

        Returns the hypotheses of the current trajectories, int64 [n], negative for none; all hypotheses, by
        id; and the events of this update. The axes of boxes are sought where `boxes` says so.
        """
        previous = window.label[current]
        allocate, by_thesis = self.allocator.next, self.by_thesis
        rested = [number for number, record in self.records.items() if record.static]
        self.ids = named(window, partition, current, allocate, stamp_ns, rested, by_thesis=by_thesis)  # 1
        since = np.where(partition.confidence >= _SURE, window.label_ns[current], NEVER_NS)
        present = Current(window.key[current], current, window.label[current], partition.position, since)
        if self._recall(stamp_ns, window, partition, present):  # 2
            present = replace(present, labels=window.label[current])
        members = present.members
        new = [number for number in members if number not in self.records]
        origins = {n: majority(previous[members[n]], (len(members[n]) + 1) // 2) for n in new}
        heirs = self._heirs(present, supported(window, current))
        sizes = {number: len(rows) for number, rows in members.items()}
        events = self.advance(stamp_ns, sizes, self._least(present), origins, heirs)  # 3
        # Nobody votes for any other hypothesis any more: an id that has ended, or vanished unconfirmed, does
        # not come back, nor with features that are out of sight.
        known = np.array(sorted(self.records), np.int64)
        for column in (window.label, window.established, self.ids):
            column[find(column, known) < 0] = NO_HYPOTHESIS
        listed = self._described(stamp_ns, partition, present, boxes)  # 4
        for number, heir in self._heirs(present, present.labels).items():
            last = self.records[number].description
            if heir is None and last is not None:
                listed.append(replace(last, size=0, absent=True, confirmed=True))
        return present.labels, sorted(listed, key=lambda h: h.id), events

    def forget(self, window: Window, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all: its members are grouped as new ones. Returns those forgotten.

        A confirmed one ends at the next update.
        """
        gone = sorted(number for number in self.records if hypothesis in (None, number))
        self._forgotten += filter(self.confirmed, gone)
        for number in gone:
            del self.records[number]
        relabel((window.label, window.established, self.ids), dict.fromkeys(gone, NO_HYPOTHESIS))
        return gone

    def _remembered(self, present: Current) -> dict[int, Record]:
        """What is known of the confirmed hypotheses without a current member, by id."""
        return {
            number: record
            for number, record in self.records.items()
            if record.description is not None and number not in present.members
        }

    def _least(self, present: Current) -> int:
        """Current members that confirm a hypothesis."""
        return MEMBERS if len(present.keys) >= _BODIES * MEMBERS else 2

    def _recall(self, stamp_ns: int, window: Window, partition: Partition, present: Current) -> bool:
        """Give new groups the ids of the remembered hypotheses that they are; returns whether any is."""
        least, missing = self._least(present), self._remembered(present)
        groups = {
            new: present.slots[rows]
            for new, rows in present.members.items()
            if missing and len(rows) >= least and not self.confirmed(new)
        }
        if not groups:
            return False
        described = zip(self.ids.tolist(), partition.described, strict=False)
        static = next((number for number, group in described if group.static), None)
        heirs = self._heirs(present, present.labels)
        names = {heir: old for old, heir in heirs.items() if heir in groups and heir != static}
        lost = [old for old in missing if heirs[old] is None]
        due = [new for new in groups if self.due(new, stamp_ns)]
        first = {new: None if new == static else appearance(window, slots) for new, slots in groups.items()}
        for candidates, margin in ((groups, _CLEAR), (due, _LIKELY)):
            unnamed = {new: seen for new, seen in first.items() if new not in names}
            free = {old: missing[old] for old in lost if old not in names.values()}
            pairs = recognised(free, unnamed, margin)
            names |= {new: old for new, old in pairs.items() if new in candidates}
        relabel((window.label, window.established, self.ids), names)
        for new, old in names.items():
            centroid = present.positions[present.members[new]].mean(0)
            missing[old].move(None if new == static else centroid, stamp_ns)
        return bool(names)

    def _heirs(self, present: Current, labels: Labels) -> dict[int, int | None]:
        """The hypothesis, by labels int64 [n], in which most of the last members of a remembered one are."""
        remembered = self._remembered(present)
        return {number: record.heir(present.keys, labels) for number, record in remembered.items()}

    def _described(
        self, stamp_ns: int, partition: Partition, present: Current, boxes: bool
    ) -> list[Hypothesis]:
        """Hypotheses that have a current member, measured and described, with their records up to date."""
        listed = []
        for group, number in zip(partition.described, self.ids.tolist(), strict=True):
            record = self.records.get(number)
            if record is None:
                continue
            # A hypothesis without a current member keeps its pose up to date for their return.
            pose = None if group.pose_since is None else group.pose_since(record.reference)
            if number not in present.members:
                continue
            centroid = record.see(stamp_ns, number, present, posed=pose is not None)
            record.static = group.static
            described = Hypothesis.trusted(
                id=number,
                space=self.space,
                size=len(present.members[number]),
                born_ns=record.reference.born_ns,
                state=group.state,
                centroid=centroid.tolist(),
                pose=pose,
                twist=group.twist,
                noise=group.noise,
                confirmed=self.confirmed(number),
                box=box_of(record, seek=boxes),
            )
            record.description = described if described.confirmed else None
            listed.append(described)
        return listed

    def confirmed(self, hypothesis: int) -> bool:
        """Whether it has had its first event."""
        return hypothesis in self.records and self.records[hypothesis].stage != "unconfirmed"

    def due(self, hypothesis: int, stamp_ns: int) -> bool:
        """Whether a hypothesis is confirmed at this time, if it has enough members then."""
        record = self.records.get(hypothesis)
        if record is None or record.support_ns is None or self._stamp_ns is None:
            return self._confirm_ns <= 0
        return record.support_ns + stamp_ns - self._stamp_ns >= self._confirm_ns

    def advance(
        self,
        stamp_ns: int,
        sizes: Mapping[int, int],
        least: int,
        origins: Mapping[int, int | None],
        heirs: Mapping[int, int | None],
    ) -> list[Event]:
        """Take in an update; returns its events, beginnings first, then by kind and id.

        `sizes` are the current members of each hypothesis that has any, of which `least` confirm it.
        `origins` of new ones are those that most members have left, None for none; `heirs` those that most of
        the last members of one vote for now, which may be itself still.
        """
        step = 0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0)
        self._stamp_ns = stamp_ns
        for number in sorted(sizes.keys() - self.records.keys()):
            self.records[number] = Record(PoseReference.new(stamp_ns), origins.get(number))
        changes: list[_Change] = [("ended", number, []) for number in self._forgotten]
        self._forgotten = []
        merged: dict[int, list[int]] = {}
        for number, record in sorted(self.records.items()):
            if number in sizes:
                enough = sizes[number] >= least
                changes += self._seen(number, record, step if enough else -max(step, 1))
            elif record.stage == "unconfirmed":
                del self.records[number]
            elif self._lost(stamp_ns, record) and (heir := heirs.get(number)) != number:
                if heir is None:
                    record.stage = "absent"
                    changes.append(("absent", number, []))
                elif self.confirmed(heir):
                    merged.setdefault(heir, []).append(number)
        changes += [("merged", heir, gone) for heir, gone in merged.items()]
        # The absent ones that are remembered no longer, the longest absent first.
        absent = ((r.since_ns, number) for number, r in self.records.items() if r.stage == "absent")
        waiting = sorted((since, number) for since, number in absent if since is not None)
        oldest_ns = stamp_ns - to_ns(self.config.memory)
        surplus = len(waiting) - _REMEMBERED
        expired = [number for k, (since, number) in enumerate(waiting) if k < surplus or since < oldest_ns]
        for number in chain(expired, *merged.values()):
            del self.records[number]
        changes += [("ended", number, []) for number in expired]
        changes.sort(key=lambda change: (_ORDER.index(change[0]), change[1]))
        return [
            Event(stamp_ns=stamp_ns, kind=k, hypothesis=number, others=others)
            for k, number, others in changes
        ]

    def _seen(self, number: int, record: Record, step: int) -> list[_Change]:
        # The time before it appeared or returned does not count for it.
        record.support_ns = 0 if record.support_ns is None else max(record.support_ns + step, 0)
        record.since_ns = None
        if record.stage == "present" or step < 0 or record.support_ns < self._confirm_ns:
            return []
        last, record.stage = record.stage, "present"
        if last == "absent":
            return [("returned", number, [])]
        if record.origin is not None and self.confirmed(record.origin):
            return [("split", number, [record.origin])]
        return [("born", number, [])]

    def _lost(self, stamp_ns: int, record: Record) -> bool:
        """Whether a hypothesis has been without current members for long enough to say so."""
        record.support_ns = None
        record.since_ns = stamp_ns if record.since_ns is None else record.since_ns
        return record.stage == "present" and stamp_ns - record.since_ns >= self._confirm_ns
