"""What is known of each hypothesis over time, and of the current trajectories of an update."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from comotion_schemas import Hypothesis

from ..arrays import Bools, Floats, Ints, Labels, Slots, Stamps, find
from ..partition import NO_HYPOTHESIS, PoseReference


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

    def heir(self, keys: Stamps, labels: Labels) -> int | None:
        """Hypothesis that most of the last members belong to now; None if more of them are lost.

        Parameters
        ----------
        keys, labels
            int64 [n], the current trajectories, ascending, and their hypotheses.
        """
        at = find(self.keys, keys)
        now = labels[at[at >= 0]]
        found, counts = np.unique(now[now != NO_HYPOTHESIS], return_counts=True)
        if not len(found) or 2 * counts.sum() <= len(self.keys):
            return None
        return int(found[counts.argmax()])


@dataclass
class Extent:
    """Points of one body: keys int64 [m] ascending, `points` float64 [m, dim] in the axes of the body.

    `since` int64 [m], when each became a member; `axes` float64 [dim, dim], those of the box, as columns;
    `sought_ns`, when they were sought last.
    """

    keys: Stamps
    points: Floats
    since: Stamps
    axes: Floats
    sought_ns: int

    def without_points(self) -> "Extent":
        """The same axes alone."""
        return replace(self, keys=self.keys[:0], points=self.points[:0], since=self.since[:0])


@dataclass
class Record:
    """A hypothesis over time.

    Attributes
    ----------
    origin
        The hypothesis that it has left, None where its members came from nowhere.
    stage
        As of the events so far.
    support_ns
        Time with enough members less time with too few, since it appeared or returned; None while it has
        no current member.
    since_ns
        Event time since when it has had no current member; None while it has any.
    trace
        As it was last seen; None before it is confirmed.
    extent
        What its box is about; None where nothing is known, as of how it has turned out of sight.
    """

    origin: int | None = None
    stage: Literal["unconfirmed", "present", "absent"] = "unconfirmed"
    support_ns: int | None = None
    since_ns: int | None = None
    trace: Trace | None = None
    extent: Extent | None = None


@dataclass(frozen=True)
class Current:
    """The current trajectories of a space by key.

    Attributes
    ----------
    keys, slots
        int64 [n], ascending, and intp [n].
    labels
        int64 [n], hypothesis of each, negative for none.
    positions
        float64 [n, dim].
    sure
        bool [n]: whether the label is more likely right than wrong.
    """

    keys: Stamps
    slots: Slots
    labels: Labels
    positions: Floats
    sure: Bools

    @cached_property
    def members(self) -> dict[int, Ints]:
        """Rows of the members of each hypothesis that has any, ascending."""
        order = np.argsort(self.labels, kind="stable")
        names, first = np.unique(self.labels[order], return_index=True)
        rows = zip(names.tolist(), np.split(order, first[1:]), strict=False)
        return {one: mine for one, mine in rows if one != NO_HYPOTHESIS}

    def centroid(self, one: int) -> Floats:
        """Of a hypothesis that has members, float64 [dim]."""
        return np.asarray(self.positions[self.members[one]].mean(0), np.float64)
