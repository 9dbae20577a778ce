"""Carries from update to update which body each trajectory before a resting camera belongs to.

The background rests: that is one hypothesis that needs no fit. Each trajectory carries evidence for it and
for each body, as logarithms of odds against belonging to none, within limits. Motion that a hypothesis
explains adds to it, motion that it does not explain takes away from it. What nothing explains has no body,
until enough neighbours move as it does: they become a body. Where all rest, nothing changes: a trajectory
that came to rest keeps its body. What rests may be grasped at any time, while what a body has moved hardly
becomes background again: little evidence is kept against the bodies that a trajectory was not on.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels, Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window
from .gains import BODY_SCALES, group_gain, rest_gain
from .newborns import nearest_votes
from .proposals import LEAST_MEMBERS, Together, as_one, find_groups
from .recent import Recent
from .structure import Structure

BACKGROUND = 0
"""Column of the background."""

# nat; limit of the evidence on either side, most that is kept against a body by what is on no body, and most
# that neighbours are worth for a newborn trajectory.
_MOST, _MOST_AGAINST, _NEIGHBOURS = 4.0, 0.5, 2.0
# Share of the reach within which these neighbours lie: features behind a body at rest do not join it.
_PLACE = 0.25
# nat; of the members of a new body, and what sets a body apart from the background.
_FIRST, _CLEAR = 1.0, 1.0
# ns; a body has lasted once its age times its members is so much: few members take longer to be sure of.
_LASTED_NS = 3_000_000_000
# nat; against rest, by a group: so much takes it off the background at once. Members that count before a
# camera that rests: what sways does so together, and that more do tells no more.
_LEAVES_AS_ONE, _COUNTED = 20.0, 13
# ns; a body is dropped if it is older and has not lasted, or had no member for so long.
_GONE_NS = 1_000_000_000
# Members without which a body that has not lasted is dropped.
_GOING_ON = 4
# px; a trajectory that has moved less within .25 s rests.
_AT_REST_PX = 0.5


@dataclass
class Body:
    """A body beside the background, or the background.

    Attributes
    ----------
    born_ns, seen_ns
        When it was born, and when it had a member last.
    lasted
        Whether it may take members from others.
    """

    born_ns: int
    seen_ns: int
    lasted: bool = False


class Belief:
    """Evidence of all slots of a window for the background and for each body.

    Parameters
    ----------
    labels
        int64 [capacity]; hypotheses of slots so far, negative for none. The one with most members at rest
        becomes the background, the others bodies.
    resting
        intp [n]; slots of trajectories at rest.

    Attributes
    ----------
    bodies
        By column of the evidence; None for a free one. The first is the background.
    variance
        float64 [capacity], px²; noise of a coordinate of each slot at the last step, NaN unknown.
    """

    def __init__(self, window: Window, labels: Labels, resting: Slots) -> None:
        ids = np.unique(labels[labels >= 0])
        counts = (labels[resting] == ids[:, None]).sum(axis=1)
        ids = ids[np.argsort(-counts, kind="stable")]
        self.bodies: list[Body | None] = [Body(0, 0, lasted=True) for _ in range(max(len(ids), 1))]
        # -inf until a trajectory has been seen.
        self._evidence = np.where(labels[:, None] >= 0, np.full(len(self.bodies), -_MOST), -np.inf)
        for column, name in enumerate(ids.tolist()):
            self._evidence[labels == name, column] = _MOST
        self._keys = window.key[: len(labels)].copy()
        # By slot: whether its own motion has been seen, and not its place alone.
        self._seen = labels >= 0
        # And whether it was shown as one of the background, or of a body that has lasted.
        self._known = labels >= 0
        self._together, self._structure = Together(), Structure()
        self.variance = np.full(len(labels), np.nan)

    def step(self, window: Window, recent: Recent, stamp_ns: int, *, carried: bool) -> None:
        """Take in the motion of trajectories that were admitted up to an instant."""
        # What comes into the view of a camera that is carried is of the background as likely as of a body.
        self._known[recent.slots] |= carried
        rest, labels = rest_gain(recent), self.labels(recent.slots)
        voters = np.where(self._clear(recent.slots), labels, NO_HYPOTHESIS)
        votes = nearest_votes(recent.position, voters, len(self.bodies), _PLACE * recent.reach)
        self._place(recent.slots, votes)
        gain = self._gains(recent, rest, labels, votes)
        self._seen[recent.slots] |= recent.seen[0]
        evidence = self._evidence[recent.slots] + gain
        evidence -= np.maximum(evidence.max(axis=1, keepdims=True) - _MOST, 0)
        fully = (labels[:, None] > BACKGROUND) | (np.arange(len(self.bodies)) == BACKGROUND)
        least = np.where(fully, -_MOST, -_MOST_AGAINST)
        self._evidence[recent.slots] = np.maximum(evidence, least)
        lately = rest_gain(recent, BODY_SCALES)
        self._propose(recent, rest, lately, stamp_ns)
        self._merge(window, recent, lately, stamp_ns)
        self._split(window, recent, stamp_ns)
        self._review(recent, stamp_ns)
        self.variance = np.full(window.capacity, np.nan)
        self.variance[recent.slots] = recent.variance
        shown = self.shown(recent.slots)
        self._known[recent.slots] |= (shown != NO_HYPOTHESIS) & self._lasted(shown)

    def labels(self, slots: Slots) -> Ints:
        """Column of the body of each slot, intp [n]; :data:`NO_HYPOTHESIS` for those of no body."""
        evidence = self._evidence[slots]
        best = evidence.argmax(axis=1)
        return np.where(evidence[np.arange(len(slots)), best] > 0, best, NO_HYPOTHESIS)

    def shown(self, slots: Slots) -> Ints:
        """As :meth:`labels`, without what is not clear, or has left what it was of for a body that is young.

        The background is what rests: a trajectory must have been seen at rest, its place is not enough.
        """
        labels = self.labels(slots)
        evident = np.where(self._seen[slots], self._clear(slots), labels > BACKGROUND)
        return np.where(evident & (self._lasted(labels) | ~self._known[slots]), labels, NO_HYPOTHESIS)

    def _lasted(self, labels: Ints) -> Bools:
        return np.array([body is not None and body.lasted for body in self.bodies])[labels]

    def _clear(self, slots: Slots) -> Bools:
        """Whether each slot is either of the background or of a body, bool [n]: beside a body both may be."""
        evidence = self._evidence[slots]
        of_body = evidence[:, 1:].max(axis=1, initial=-_MOST)
        lead = np.maximum(of_body, -_MOST) - np.maximum(evidence[:, BACKGROUND], -_MOST)
        return np.asarray(abs(lead) >= _CLEAR)

    def confidence(self, slots: Slots) -> Floats:
        """Probability of the body of each slot against the best other one, or none, float64 [n]."""
        evidence = np.sort(np.pad(self._evidence[slots], ((0, 0), (1, 0))), axis=1)
        return np.asarray(1 / (1 + np.exp(evidence[:, -2] - evidence[:, -1])))

    def admit(self, window: Window) -> None:
        """Extend the columns to every slot, and reset those that have a new trajectory."""
        slots = window.slots()
        extra = window.capacity - len(self._keys)
        if extra:
            self._evidence = np.pad(self._evidence, ((0, extra), (0, 0)), constant_values=-np.inf)
            self._keys = np.pad(self._keys, (0, extra), constant_values=-1)
            self._seen, self._known = np.pad([self._seen, self._known], ((0, 0), (0, extra)))
        fresh = slots[self._keys[slots] != window.key[slots]]
        self._evidence[fresh], self._seen[fresh], self._known[fresh] = -np.inf, False, False
        self._keys[fresh] = window.key[fresh]

    def _place(self, slots: Slots, votes: Floats) -> None:
        """Evidence of newborn trajectories from their neighbours; from nowhere else they are background."""
        new = np.isneginf(self._evidence[slots, BACKGROUND])
        votes = votes[new]
        # What no neighbour accounts for is background: that is everywhere.
        votes[:, BACKGROUND] += 1 - votes.sum(axis=1)
        first = np.maximum(_NEIGHBOURS + np.log(np.maximum(votes, 1e-9)), -_NEIGHBOURS)
        self._evidence[slots[new]] = first

    def _gains(self, recent: Recent, rest: Floats, labels: Ints, votes: Floats) -> Floats:
        """Gain under each hypothesis, float64 [n, K]."""
        gain = np.zeros((len(labels), len(self.bodies)))
        gain[:, BACKGROUND] = rest
        step = np.where(recent.seen[1, :, None], recent.displacement[1], recent.displacement[0])
        moves = np.linalg.norm(step, axis=1) >= _AT_REST_PX
        for column, _ in self._living():
            members = labels == column
            explained = group_gain(recent, members)
            # Any hypothesis may explain what rests: that is evidence for a body only near its members.
            relevant = members | (votes[:, column] > 0) | moves
            gain[:, column] = np.where(relevant, explained, np.minimum(explained, 0.0))
        return gain

    def _propose(self, recent: Recent, rest: Floats, lately: Floats, stamp_ns: int) -> None:
        """Make bodies of trajectories that nothing explains, or members of bodies that move alike."""
        labels, bodies = self.labels(recent.slots), self._members(recent, stamp_ns)
        free = (labels <= BACKGROUND) & (rest < 0) & recent.seen[0]
        for group in find_groups(recent, free):
            counted = len(group) if recent.tolerance.any() else min(len(group), _COUNTED)
            leaves = rest[group].mean() * counted < -_LEAVES_AS_ONE
            members = group if leaves else group[labels[group] < 0]
            if len(members) < LEAST_MEMBERS:
                continue
            fits = {column: as_one(recent, lately, rows, members) for column, rows in bodies.items()}
            column = max(fits, key=lambda candidate: fits[candidate], default=BACKGROUND)
            if fits.get(column, 0.0) <= 0:
                column = self._new_column(stamp_ns)
            slots = recent.slots[members]
            self._evidence[slots, column] = _FIRST
            # What has left the background as one need not have left it one by one.
            self._evidence[slots, BACKGROUND] = np.minimum(self._evidence[slots, BACKGROUND], 0.0)

    def _merge(self, window: Window, recent: Recent, lately: Floats, stamp_ns: int) -> None:
        members = self._members(recent, stamp_ns)
        self._together.compare(recent, lately, members)
        lasted = {column for column, body in self._living() if body.lasted}
        # A look takes long: there is one in a step at most.
        may_look = not self._structure.is_due(stamp_ns)
        while (pair := self._together.merged(lasted, both=may_look)) is not None:
            rows = [members[column] for column in pair]
            if lasted.issuperset(pair):
                may_look = False
                if not self._structure.are_one(window, recent, rows, stamp_ns):
                    self._together.part(*pair)
                    continue
            born = {column: body.born_ns for column, body in self._living()}
            older, younger = sorted(pair, key=lambda column: (born[column], column))
            self._evidence[:, older] = self._evidence[:, [older, younger]].max(axis=1)
            self._drop(younger)

    def _split(self, window: Window, recent: Recent, stamp_ns: int) -> None:
        if not self._structure.is_due(stamp_ns):
            return
        rows_of = self._members(recent, stamp_ns)
        lasted = [column for column, body in self._living() if body.lasted and column in rows_of]
        members = {column: rows_of[column] for column in lasted}
        parted = self._structure.parted(window, recent, members, stamp_ns)
        if parted is None:
            return
        column, rows = parted
        slots, new = recent.slots[rows], self._new_column(stamp_ns, lasted=True)
        self._evidence[slots, new] = self._evidence[slots, column]
        self._evidence[slots, column] = -_MOST_AGAINST
        self._together.part(column, new)

    def _review(self, recent: Recent, stamp_ns: int) -> None:
        """Note which bodies have lasted; drop those that have not, or have no members."""
        sizes = np.bincount(self.labels(recent.slots) + 1, minlength=len(self.bodies) + 1)[1:]
        for column, body in self._living():
            age_ns, size = stamp_ns - body.born_ns, int(sizes[column])
            if size:
                body.seen_ns = stamp_ns
            body.lasted |= age_ns * size >= _LASTED_NS and size >= _GOING_ON
            fades = not body.lasted and (age_ns > _GONE_NS or size < _GOING_ON)
            if fades or stamp_ns - body.seen_ns > _GONE_NS:
                self._drop(column)

    def _members(self, recent: Recent, stamp_ns: int) -> dict[int, Ints]:
        """Rows of the members of each body beside the background that is not born at this step."""
        labels = self.labels(recent.slots)
        return {column: np.flatnonzero(labels == column) for column in self.older_than(stamp_ns)}

    def older_than(self, stamp_ns: int) -> list[int]:
        """Labels of the bodies beside the background that were born before a time."""
        return [column for column, body in self._living() if body.born_ns < stamp_ns]

    def _living(self) -> list[tuple[int, Body]]:
        """Bodies beside the background, with their columns."""
        return [(column, body) for column, body in enumerate(self.bodies) if column and body is not None]

    def _new_column(self, stamp_ns: int, *, lasted: bool = False) -> int:
        if None not in self.bodies:
            self.bodies.append(None)
            self._evidence = np.pad(self._evidence, ((0, 0), (0, 1)), constant_values=-_MOST)
        column = self.bodies.index(None)
        self.bodies[column] = Body(stamp_ns, stamp_ns, lasted)
        return column

    def _drop(self, column: int) -> None:
        self.bodies[column] = None
        self._evidence[:, column] = -_MOST
        self._together.forget(column)
        self._structure.forget(column)
