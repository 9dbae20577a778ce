"""Gives a standby's updates the ids that the active service publishes.

A standby fuses the same observations as the active service, but both give ids in the order in which they
find bodies. So the standby compares its own updates with the published ones: hypotheses that share most
trajectories are the same body. When it takes over, it publishes under the ids that clients know.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from comotion_schemas import UNDETERMINED, Event, Hypothesis, HypothesisUpdate, Pose
from comotion_schemas.rigid import pose_of, transform

from .arrays import Ints, Labels, find
from .hypotheses.events import EVENT_MEMORY_NS
from .hypotheses.identity import ID_GAP, IdAllocator
from .matching import largest_total, shared_counts
from .saving import NOT_KEPT

# ns; so long after its last update the bodies of another service are recognised by their trajectories.
_TAKEOVER_NS = 10_000_000_000


@dataclass(frozen=True)
class _Origin:
    """The birth that clients know, and the motion from there to the birth here; None where unknown."""

    born_ns: int
    motion: RigidTransform | None = None


@dataclass
class PublishedIds:
    """The ids and births under which the hypotheses of this service are published.

    Attributes
    ----------
    ids
        Gives out those that nothing has been published under.
    """

    _names: dict[int, int] = field(default_factory=dict)
    _origins: dict[int, _Origin] = field(default_factory=dict)
    ids: IdAllocator = field(default_factory=IdAllocator)
    _leader: HypothesisUpdate | None = field(default=None, metadata=NOT_KEPT)

    def follow(self, own: HypothesisUpdate, leader: HypothesisUpdate) -> None:
        """Take over the ids of what the active service has published.

        `own` is the last update of this service, with its own ids; that of the leader has about the same
        watermark.
        """
        highest = max((h.id for h in leader.hypotheses), default=0)
        # The leader may have given out ids in updates that were lost with it.
        self.ids.following = max(self.ids.following, highest + ID_GAP)
        self._leader = leader
        present, given = {h.id for h in own.hypotheses if not h.absent}, {h.id for h in leader.hypotheses}
        self._names = {
            one: name for one, name in self._names.items() if one not in present or name not in given
        }
        unknown = {one for one in present if self._names.get(one) not in given}
        self._take_over(own, leader, unknown)

    def apply(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """An update of this service with the ids, births and events that clients know."""
        leader = self._leader
        if leader is not None and update.stamp_ns - leader.stamp_ns <= _TAKEOVER_NS:
            present = {h.id for h in update.hypotheses if not h.absent}
            self._take_over(update, leader, present - set(self._names))
        led_until_ns, events = (0, []) if leader is None else (leader.stamp_ns, leader.events)
        told = ((e.hypothesis, *e.others) for e in update.events)
        names = {one: self.name(one) for one in sorted({h.id for h in update.hypotheses}.union(*told))}
        recent = [e for e in update.events if e.stamp_ns > led_until_ns]
        oldest_ns = update.stamp_ns - EVENT_MEMORY_NS
        return replace(
            update,
            track_hypothesis=_renamed(update.track_hypothesis, names),
            hypotheses=sorted((self._hypothesis(h, names) for h in update.hypotheses), key=lambda h: h.id),
            joints=[replace(j, parent=names[j.parent], child=names[j.child]) for j in update.joints],
            events=[e for e in events if e.stamp_ns >= oldest_ns] + [_event(e, names) for e in recent],
        )

    def own(self, published: int) -> int | None:
        """The id inside this service of a published one."""
        return next((one for one, name in self._names.items() if name == published), None)

    def _take_over(self, own: HypothesisUpdate, leader: HypothesisUpdate, unnamed: set[int]) -> None:
        """Name some hypotheses as a published update does, as far as it knows them."""
        mine, theirs = {h.id: h for h in own.hypotheses}, {h.id: h for h in leader.hypotheses}
        kept = {self._names[one] for one in mine if one in self._names and not mine[one].absent}
        pairs = {
            one: name
            for one, name in (same_bodies(own, leader).items() if unnamed else ())
            if one in unnamed and name not in kept
        }
        taken = set(pairs.values())
        self._names = {one: name for one, name in self._names.items() if name not in taken} | pairs
        for one, name in pairs.items():
            known = self._origins.get(one)
            if known is None or known.born_ns != theirs[name].born_ns or own.stamp_ns == leader.stamp_ns:
                self._origins[one] = _origin(mine[one], theirs[name])
        self._origins = {one: self._origins[one] for one in self._names if one in self._origins}

    def name(self, one: int) -> int:
        """The published id of a hypothesis; a fresh one if it has none."""
        if one not in self._names:
            self._names[one] = self.ids.next()
        return self._names[one]

    def _hypothesis(self, found: Hypothesis, names: Mapping[int, int]) -> Hypothesis:
        origin = self._origins.get(found.id)
        born_ns = found.born_ns if origin is None else origin.born_ns
        linked = None if found.linked is None else sorted(self.name(one) for one in found.linked)
        pose = found.pose if origin is None or found.pose is None else _since(found.pose, origin)
        return replace(found, id=names[found.id], born_ns=born_ns, pose=pose, linked=linked)


def same_bodies(own: HypothesisUpdate, leader: HypothesisUpdate) -> dict[int, int]:
    """Hypotheses of two updates of one scene that share most trajectories, {id in own: id in leader}.

    The assignment with most shared trajectories in all (Kuhn 1955), among hypotheses of the same space.
    """
    before, now = _labels_of_shared(own, leader)
    theirs = sorted(leader.hypotheses, key=lambda h: h.id)
    columns = find(now, np.array([h.id for h in theirs], np.int64))
    known, shared = shared_counts(before, columns, len(theirs))
    space = {h.id: h.space for h in own.hypotheses}
    other = np.array([h.space for h in theirs], object)
    for row, one in enumerate(known.tolist()):
        shared[row, other != space[one]] = 0
    return {int(known[row]): theirs[column].id for row, column in largest_total(shared)}


def _labels_of_shared(own: HypothesisUpdate, leader: HypothesisUpdate) -> tuple[Labels, Labels]:
    """Hypotheses in both updates of the trajectories that are in both, int64 [N] each, negative for none."""
    at = {(source.name, source.session): k for k, source in enumerate(leader.sources)}
    mine, theirs = [np.empty(0, np.intp)], [np.empty(0, np.intp)]
    for k, source in enumerate(own.sources):
        here = np.flatnonzero(own.track_source == k)
        there = np.flatnonzero(leader.track_source == at.get((source.name, source.session), -1))
        _, i, j = np.intersect1d(own.track_id[here], leader.track_id[there], return_indices=True)
        mine.append(here[i])
        theirs.append(there[j])
    return _labels(own, np.concatenate(mine)), _labels(leader, np.concatenate(theirs))


def _labels(update: HypothesisUpdate, rows: Ints) -> Labels:
    labels: Labels = update.track_hypothesis[rows].astype(np.int64)
    labels[labels == UNDETERMINED] = -1
    return labels


def _origin(mine: Hypothesis, theirs: Hypothesis) -> _Origin:
    """From poses of one body at one time, since its births here and there."""
    if mine.pose is None or theirs.pose is None:
        return _Origin(theirs.born_ns)
    return _Origin(theirs.born_ns, transform(mine.pose).inv() * transform(theirs.pose))


def _since(pose: Pose, origin: _Origin) -> Pose:
    """The pose since the birth that clients know."""
    if origin.motion is None:
        return pose
    return pose_of(transform(pose) * origin.motion, len(pose.translation))


def _renamed(labels: NDArray[np.uint32], names: Mapping[int, int]) -> NDArray[np.uint32]:
    renamed = labels.copy()
    for one, name in names.items():
        renamed[labels == one] = name
    return renamed


def _event(event: Event, names: Mapping[int, int]) -> Event:
    return replace(event, hypothesis=names[event.hypothesis], others=[names[one] for one in event.others])
