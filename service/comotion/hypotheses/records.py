"""What is known of each hypothesis over time, one record each, and the current trajectories of an update."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from comotion_schemas import Hypothesis

from ..arrays import Bools, Floats, Ints, Labels, Slots, Stamps, Table, find, median
from ..partition import NO_HYPOTHESIS, PoseReference

# ns; lost features count among the last members of their hypothesis for so long.
_LAST_MEMBERS_NS = 2_000_000_000
# ns; a lost feature that was a member for less says nothing about the body.
_LASTING_NS = 500_000_000
# s; the place about which a body moves, and the sides of a box without a pose, are means over so long.
_PLACE, _SIDES = 5.0, 0.25
MEMBERS = 3
"""Current members that confirm a hypothesis, and that decide alone whose id it has."""
NEVER_NS = 2**62
"""Later than any time."""
FAR = 8.0
"""Times the usual distance to the second neighbour from which on a point is far from all others."""


@dataclass(frozen=True)
class Current:
    """The current trajectories of a space by key."""

    keys: Stamps
    slots: Slots
    """int64 [n], ascending, and intp [n]."""
    labels: Labels
    """int64 [n], hypothesis of each, negative for none."""
    positions: Floats
    """float64 [n, dim]."""
    since: Stamps
    """int64 [n] ns, since when each has its label; later than any time where that is more likely wrong."""

    @cached_property
    def members(self) -> dict[int, Ints]:
        """Rows of the members of each hypothesis that has any, ascending."""
        order = np.argsort(self.labels, kind="stable")
        names, first = np.unique(self.labels[order], return_index=True)
        rows = zip(names.tolist(), np.split(order, first[1:]), strict=False)
        return {number: members for number, members in rows if number != NO_HYPOTHESIS}


@dataclass(frozen=True)
class Members(Table):
    """Features of one body that are seen, or were lost: a table of m rows."""

    keys: Stamps
    """int64 [m], ascending."""
    points: Floats
    """float64 [m, dim], in the axes of the body; of the space where it has no pose."""
    seen: Stamps
    """int64 [m] ns, when each was seen last."""
    since: Stamps
    """int64 [m] ns, since when it was a member; later than any time where it more likely was not."""

    @classmethod
    def none(cls) -> "Members":
        """No rows."""
        nothing = np.zeros(0, np.int64)
        return cls(nothing, np.zeros((0, 0)), nothing, nothing)

    def lost(self, current: Stamps, oldest_ns: int, *, posed: bool) -> "Members":
        """Those that are not seen, and still tell something.

        `current` int64 [n], ascending: the keys of what is seen, in whatever hypothesis. Without a pose
        nothing tells where a feature is that was lost before `oldest_ns`.
        """
        if not len(self.keys):
            return self
        telling = find(self.keys, current) < 0
        if not telling.any():
            return self.of(slice(0))
        telling &= (self.seen >= oldest_ns) | (posed & self.lasted)
        return self if telling.all() else self.of(telling)

    def joined(self, other: "Members") -> "Members":
        """These and others, ascending."""
        if not len(self.keys) or not len(other.keys):
            return self if len(self.keys) else other
        both = super().joined(other)
        return both.of(np.argsort(both.keys))

    @property
    def shown(self) -> Floats:
        """Points of those that are members more likely than not, else of all."""
        sure = self.since != NEVER_NS
        return self.points[sure] if sure.any() else self.points

    @property
    def lasted(self) -> Bools:
        """Which were members for long enough to tell of the body when they are lost, bool [m]."""
        return np.asarray(self.seen - self.since >= _LASTING_NS)


@dataclass
class Record:
    """A hypothesis over time."""

    reference: PoseReference
    """Its birth and its pose."""
    origin: int | None = None
    """The hypothesis that it has left, None where its members came from nowhere."""
    stage: Literal["unconfirmed", "present", "absent"] = "unconfirmed"
    """As of the events so far."""
    support_ns: int | None = None
    """Time with enough members less time with too few, since it appeared or returned; None while it has no
    current member."""
    since_ns: int | None = None
    """Event time since when it has had no current member; None while it has any."""
    seen_ns: int = -NEVER_NS
    """When it was last seen."""
    posed: bool = False
    """Whether its pose was known when it was last seen."""
    members: Members = field(default_factory=Members.none)
    lost: Members = field(default_factory=Members.none)
    """Of now, or as it was last seen, and those that are out of sight; none where nothing is known, as of how
    it has turned out of sight."""
    axes: Floats | None = None
    spacing: float = 0.0
    sought_ns: int = -NEVER_NS
    """float64 [dim, dim], axes of its box as columns, in those of the body; the usual distance of its points
    to the second neighbour; when both were sought last."""
    sides: Floats = field(default_factory=lambda: np.zeros((2, 0)))
    """float64 [2, dim], lower and upper sides of its box in the axes of the space, while it has no pose."""
    description: Hypothesis | None = None
    """As it was published last; None before it is confirmed."""
    static: bool = False
    """Whether it was the static body."""
    place: Floats = field(default_factory=lambda: np.zeros(0))
    spread: float = 0.0
    """float64 [dim], where its centroid has been in the mean of the last seconds; variance of a coordinate
    about it."""

    @property
    def pose(self) -> tuple[Floats, Floats]:
        """R float64 [dim, dim] and t float64 [dim] that take its points to the space, as it was last seen."""
        dim = len(self.place)
        if not self.posed:
            return np.eye(dim), np.zeros(dim)
        return self.reference.R[:dim, :dim], self.reference.t[:dim]

    @property
    def speed(self) -> float:
        """Of the centroid, per second, as published last; 0 where unknown."""
        twist = None if self.description is None else self.description.twist
        return 0.0 if twist is None else float(np.linalg.norm(twist.linear))

    @property
    def last(self) -> Members:
        """Those that were seen within two seconds before it was last seen."""
        lost = self.lost
        return self.members.joined(lost.of(lost.seen >= self.seen_ns - _LAST_MEMBERS_NS))

    @property
    def positions(self) -> Floats:
        """Where its last members were when it was last seen, float64 [m, dim]."""
        R, t = self.pose
        return np.asarray(self.last.points @ R.T + t, np.float64)

    def see(self, stamp_ns: int, hypothesis: int, current: Current, *, posed: bool) -> Floats:
        """Take in its current members, with the reference brought up to date where it is `posed`.

        Returns their centroid, float64 [dim].
        """
        rows = current.members[hypothesis]
        positions, seconds = current.positions.take(rows, 0), max(stamp_ns - self.seen_ns, 0) * 1e-9
        centroid = np.asarray(positions.sum(0) / len(rows), np.float64)
        self._settle(centroid, seconds)
        previous = (self.members, self.lost) if posed == self.posed else (Members.none(), Members.none())
        self.seen_ns, self.posed = stamp_ns, posed
        R, t = self.pose
        seen_ns, since = np.full(len(rows), stamp_ns), current.since[rows]
        self.members = Members(current.keys[rows], (positions - t) @ R, seen_ns, since)
        oldest_ns = stamp_ns - _LAST_MEMBERS_NS
        gone = [members.lost(current.keys, oldest_ns, posed=posed) for members in previous]
        self.lost = gone[0].joined(gone[1])
        if not posed:
            self._reach(previous[0].joined(previous[1]), seconds)
        return centroid

    def heir(self, keys: Stamps, labels: Labels) -> int | None:
        """Hypothesis that most of the last members belong to now; None if more of them are lost.

        `keys` int64 [n], ascending, are the current trajectories, `labels` their hypotheses.
        """
        last = self.last.keys
        at = find(last, keys)
        return majority(labels[at[at >= 0]], len(last) // 2 + 1)

    def move(self, centroid: Floats | None, stamp_ns: int) -> None:
        """Take up its pose where it returns: how it has turned meanwhile is not known.

        `centroid` float64 [dim] is where its members are; None for the static body, which has not moved.
        """
        last, moved = self.reference, np.zeros(3)
        if centroid is not None:
            moved[: len(centroid)] = centroid - self.positions.mean(0)
            self.members = self.lost = Members.none()
        fresh = PoseReference.new(last.born_ns)
        self.reference = replace(fresh, R=last.R.copy(), t=last.t + moved, stamp_ns=stamp_ns)

    def _settle(self, now: Floats, seconds: float) -> None:
        """Follow the place with a centroid float64 [dim], so many seconds after the last."""
        if not len(self.place):
            self.place = now
        share = 1 - float(np.exp(-seconds / _PLACE))
        way = now - self.place
        self.place = self.place + share * way
        self.spread = (1 - share) * (self.spread + share * float(way @ way) / len(way))

    def _reach(self, previous: Members, seconds: float) -> None:
        """Carry the sides along with the members, and let them follow the outermost of these.

        So a wrong member moves them little if it soon leaves, and not at all if it is far from all others.
        """
        members, shown = self.members, self.members.shown
        sides = np.array(sides_of(shown, float(FAR * median(apart_of(shown)))))
        at = find(members.keys, previous.keys)
        kept = at >= 0
        if kept.any():
            carried = self.sides + np.median(members.points[kept] - previous.points[at[kept]], axis=0)
            sides = carried + (1 - np.exp(-seconds / _SIDES)) * (sides - carried)
        self.sides = sides


def majority(labels: Labels, least: int) -> int | None:
    """Hypothesis of most of some trajectories; None where fewer than `least` have any."""
    names, counts = np.unique(labels[labels != NO_HYPOTHESIS], return_counts=True)
    return int(names[counts.argmax()]) if len(names) and counts.sum() >= least else None


def apart_of(points: Floats) -> Floats:
    """Distance of points [m, dim] to the second neighbour, if there are as many, float64 [m]."""
    apart, _ = cKDTree(points).query(points, k=[min(3, len(points))])
    return np.asarray(apart[:, 0])


def sides_of(along: Floats, far: float) -> tuple[Floats, Floats]:
    """Least and largest coordinates [dim] of points [m, dim] that are not as far from all others.

    Of all, where more than half are: then the body has other points than those that `far` was measured on.
    """
    kept = np.arange(len(along))
    while 2 * len(kept) >= len(along):
        points = along[kept]
        ends = np.concatenate([points.argmin(0), points.argmax(0)])
        squares = ((points[ends, None] - points) ** 2).sum(2)
        alone = np.count_nonzero(squares <= far**2, 1) <= min(2, len(points) - 1)
        if not alone.any():
            return points.min(0), points.max(0)
        kept = np.delete(kept, ends[alone])
    return along.min(0), along.max(0)
