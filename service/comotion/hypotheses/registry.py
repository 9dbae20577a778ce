"""Identity, confirmation and memory of the hypotheses of one space.

The steps of an update:

1. Name the groups: those that share members with a hypothesis continue it (:mod:`.identity`).
2. Recall: a new group that is a remembered hypothesis takes its id (:mod:`.memory`).
3. Confirm hypotheses and find the events (:mod:`.events`).
4. Describe those with current members, and measure them (:mod:`.extent`).
5. Remember where each was seen (:mod:`.memory`), and list the absent ones.

What is known of each is one record (:mod:`.records`).
"""

from dataclasses import replace
from typing import Any

import numpy as np

from comotion_schemas import Event, Hypothesis

from ..arrays import Floats, Labels, Slots
from ..config import HypothesesConfig
from ..partition import NO_HYPOTHESIS, Matching, Partition, PoseReference
from ..saving import plain, refill
from ..trajectories.window import Window
from .events import Count, Lifecycle
from .extent import measured
from .identity import IdAllocator, LabelMemory, retire, supported
from .memory import appearance, recognised, seen
from .records import Current, Trace

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
    ids
        Where new hypotheses get their ids.
    config
        Of confirmation and memory.
    established
        Whether members of long standing decide which hypothesis a group continues.

    Attributes
    ----------
    labels
        Hypotheses by group, and their births.
    """

    def __init__(
        self, space: str, ids: IdAllocator, config: HypothesesConfig, *, established: bool = True
    ) -> None:
        self._space = space
        self._config = config
        self._lifecycle = Lifecycle(config)
        self.labels = LabelMemory(ids, established)

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
        labels = self.labels.name(window, partition, current, matching, stamp_ns)  # 1
        found = Current(
            window.key[current], current, labels, partition.position, partition.confidence >= _SURE
        )
        self.labels.refer(window, stamp_ns)
        if self._recall(stamp_ns, window, partition, found):  # 2
            found = replace(found, labels=window.label[current])
            self.labels.refer(window, stamp_ns)
        events = self._lifecycle.advance(stamp_ns, self._count(window, before, found))  # 3
        retire(window, self._lifecycle.records)
        listed = self._described(stamp_ns, partition, found, boxes)  # 4
        self._remember(stamp_ns, partition, found, listed)  # 5
        return found.labels, self._with_absent(listed, found), events

    def forget(self, window: Window, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all: its members are grouped as new ones. Returns those forgotten."""
        known = sorted(self._lifecycle.records)
        gone = known if hypothesis is None else [one for one in known if one == hypothesis]
        for one in gone:
            self._lifecycle.forget(one)
            self.labels.drop(window, one)
        return gone

    def state(self) -> dict[str, Any]:
        """As plain values and arrays, beside the columns of the window."""
        return {"labels": plain(self.labels), "lives": plain(self._lifecycle)}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; an empty one: start afresh on the trajectories of the window."""
        if state:
            refill(self.labels, state["labels"])
            refill(self._lifecycle, state["lives"])
        else:
            window.label[:] = window.established[:] = NO_HYPOTHESIS

    def _traces(self) -> dict[int, Trace]:
        """What is remembered of where hypotheses were, by id."""
        records = self._lifecycle.records
        return {one: record.trace for one, record in records.items() if record.trace is not None}

    def _least(self, found: Current) -> int:
        """Current members that confirm a hypothesis."""
        return self._config.members if len(found.keys) >= _BODIES * self._config.members else 2

    def _recall(self, stamp_ns: int, window: Window, partition: Partition, found: Current) -> bool:
        """Rename the new groups that are remembered hypotheses; returns whether there is any."""
        members, least, traces = found.members, self._least(found), self._traces()
        missing = [one for one in traces if one not in members]
        groups = [
            one
            for one, rows in members.items()
            if missing and len(rows) >= least and not self._lifecycle.confirmed(one)
        ]
        if not groups:
            return False
        static = self._static(partition)
        heirs = {one: traces[one].heir(found.keys, found.labels) for one in missing}
        names = {heir: one for one, heir in heirs.items() if heir in groups and heir != static}
        lost = [one for one in missing if heirs[one] is None]
        due = [one for one in groups if self._lifecycle.due(one, stamp_ns)]
        first = {
            one: None if one == static else appearance(window, found.slots[members[one]]) for one in groups
        }
        for some, margin in ((groups, _CLEAR), (due, _LIKELY)):
            left = {new: seen for new, seen in first.items() if new not in names}
            free = {one: traces[one] for one in lost if one not in names.values()}
            names |= {new: old for new, old in recognised(free, left, margin).items() if new in some}
        self._rename(stamp_ns, window, names, {new: found.centroid(new) for new in names if new != static})
        return bool(names)

    def _rename(
        self, stamp_ns: int, window: Window, names: dict[int, int], centroids: dict[int, Floats]
    ) -> None:
        """Give groups the ids that they continue, {present: other}; with the centroids of those that move."""
        traces = self._traces()
        self.labels.rename(window, names)
        for new, old in names.items():
            self.labels.references[old] = _carried(traces[old], centroids.get(new), stamp_ns)
            if new in centroids:
                self._lifecycle.records[old].extent = None

    def _static(self, partition: Partition) -> int | None:
        """The hypothesis of the static body, if there is one."""
        groups = zip(self.labels.ids.tolist(), partition.described, strict=False)
        return next((one for one, group in groups if group.static), None)

    def _count(self, window: Window, before: Labels, found: Current) -> Count:
        sizes, known = {one: len(rows) for one, rows in found.members.items()}, self._lifecycle.records
        origins = {one: _origin(before[rows]) for one, rows in found.members.items() if one not in known}
        heirs: dict[int, int] = {}
        wanted = supported(window, found.slots)
        for one, trace in self._traces().items():
            if one not in sizes and (heir := trace.heir(found.keys, wanted)) is not None:
                heirs[one] = heir
        return Count(sizes, self._least(found), origins, heirs)

    def _described(
        self, stamp_ns: int, partition: Partition, found: Current, boxes: bool
    ) -> list[Hypothesis]:
        """Hypotheses that have a current member, measured and described."""
        listed = []
        for group, one in zip(partition.described, self.labels.ids.tolist(), strict=True):
            if one == NO_HYPOTHESIS:
                continue
            reference = self.labels.references[one]
            # A hypothesis without a current member keeps its pose up to date for their return.
            pose = None if group.pose_since is None else group.pose_since(reference)
            if one not in found.members:
                continue
            record, posed = self._lifecycle.records[one], None if pose is None else reference
            record.extent, box = measured(record.extent, stamp_ns, one, found, posed, seek=boxes)
            listed.append(
                Hypothesis(
                    id=one,
                    space=self._space,
                    size=len(found.members[one]),
                    born_ns=reference.born_ns,
                    state=group.state,
                    centroid=found.centroid(one).tolist(),
                    pose=pose,
                    twist=group.twist,
                    noise=group.noise,
                    confirmed=self._lifecycle.confirmed(one),
                    box=box,
                )
            )
        return listed

    def _remember(
        self, stamp_ns: int, partition: Partition, found: Current, listed: list[Hypothesis]
    ) -> None:
        """Take down the present hypotheses. One that has just returned may yet turn out to be another."""
        static = self._static(partition)
        for one in listed:
            record = self._lifecycle.records[one.id]
            if record.stage == "present":
                reference = self.labels.references[one.id]
                record.trace = seen(record.trace, stamp_ns, found, one, reference, static=one.id == static)

    def _with_absent(self, listed: list[Hypothesis], found: Current) -> list[Hypothesis]:
        """All hypotheses, by id: those with current members, and those that are remembered without."""
        shown = {one.id for one in listed}
        gone = [
            replace(trace.description, size=0, absent=True, confirmed=True)
            for one, trace in self._traces().items()
            if one not in shown and trace.heir(found.keys, found.labels) is None
        ]
        return sorted([*listed, *gone], key=lambda h: h.id)


def _origin(before: Labels) -> int | None:
    """The hypothesis that most members were of; None where more were of none."""
    found, counts = np.unique(before[before != NO_HYPOTHESIS], return_counts=True)
    if not len(found) or 2 * counts.sum() < len(before):
        return None
    return int(found[counts.argmax()])


def _carried(trace: Trace, centroid: Floats | None, stamp_ns: int) -> PoseReference:
    """Pose reference of a hypothesis that returns: how it has turned meanwhile is not known.

    `centroid` float64 [dim] is where its members are; None for the static body, which has not moved.
    """
    last = trace.reference
    moved = np.zeros(3)
    if centroid is not None:
        moved[: len(centroid)] = centroid - trace.positions.mean(0)
    return replace(PoseReference.new(last.born_ns), R=last.R.copy(), t=last.t + moved, stamp_ns=stamp_ns)
