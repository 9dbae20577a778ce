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
        Gives out ids for hypotheses that have not been published yet.
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
            own_id: name for own_id, name in self._names.items() if own_id not in present or name not in given
        }
        unknown = {own_id for own_id in present if self._names.get(own_id) not in given}
        self._take_over(own, leader, unknown)

    def apply(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """An update of this service with the ids, births and events that clients know."""
        leader = self._leader
        if leader is not None and update.stamp_ns - leader.stamp_ns <= _TAKEOVER_NS:
            present = {h.id for h in update.hypotheses if not h.absent}
            self._take_over(update, leader, present - set(self._names))
        led_until_ns, events = (0, []) if leader is None else (leader.stamp_ns, leader.events)
        in_events = ((e.hypothesis, *e.others) for e in update.events)
        names = {
            number: self.name(number)
            for number in sorted({h.id for h in update.hypotheses}.union(*in_events))
        }
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
        return next((own_id for own_id, name in self._names.items() if name == published), None)

    def _take_over(self, own: HypothesisUpdate, leader: HypothesisUpdate, unnamed: set[int]) -> None:
        """Name some hypotheses as a published update does, as far as it knows them."""
        own_bodies, leading = {h.id: h for h in own.hypotheses}, {h.id: h for h in leader.hypotheses}
        in_use = {
            self._names[number]
            for number in own_bodies
            if number in self._names and not own_bodies[number].absent
        }
        pairs = {
            number: name
            for number, name in (same_bodies(own, leader).items() if unnamed else ())
            if number in unnamed and name not in in_use
        }
        taken = set(pairs.values())
        self._names = {number: name for number, name in self._names.items() if name not in taken} | pairs
        for number, name in pairs.items():
            origin = self._origins.get(number)
            if origin is None or origin.born_ns != leading[name].born_ns or own.stamp_ns == leader.stamp_ns:
                self._origins[number] = _origin(own_bodies[number], leading[name])
        self._origins = {number: self._origins[number] for number in self._names if number in self._origins}

    def name(self, own_id: int) -> int:
        """The published id of a hypothesis; a fresh one if it has none."""
        if own_id not in self._names:
            self._names[own_id] = self.ids.next()
        return self._names[own_id]

    def _hypothesis(self, body: Hypothesis, names: Mapping[int, int]) -> Hypothesis:
        origin = self._origins.get(body.id)
        born_ns = body.born_ns if origin is None else origin.born_ns
        linked = None if body.linked is None else sorted(self.name(other) for other in body.linked)
        pose = body.pose if origin is None or body.pose is None else _since(body.pose, origin)
        return replace(body, id=names[body.id], born_ns=born_ns, pose=pose, linked=linked)


def same_bodies(own: HypothesisUpdate, leader: HypothesisUpdate) -> dict[int, int]:
    """Hypotheses of two updates of one scene that share most trajectories, {id in own: id in leader}.

    The assignment with most shared trajectories in all (Kuhn 1955), among hypotheses of the same space.
    """
    own_labels, leader_labels = _labels_of_shared(own, leader)
    leading = sorted(leader.hypotheses, key=lambda h: h.id)
    columns = find(leader_labels, np.array([h.id for h in leading], np.int64))
    own_ids, shared = shared_counts(own_labels, columns, len(leading))
    space = {h.id: h.space for h in own.hypotheses}
    spaces = np.array([h.space for h in leading], object)
    for row, own_id in enumerate(own_ids.tolist()):
        shared[row, spaces != space[own_id]] = 0
    return {int(own_ids[row]): leading[column].id for row, column in largest_total(shared)}


def _labels_of_shared(own: HypothesisUpdate, leader: HypothesisUpdate) -> tuple[Labels, Labels]:
    """Hypotheses in both updates of the trajectories that are in both, int64 [N] each, negative for none."""
    at = {(source.name, source.session): k for k, source in enumerate(leader.sources)}
    own_rows, leader_rows = [np.empty(0, np.intp)], [np.empty(0, np.intp)]
    for k, source in enumerate(own.sources):
        in_own = np.flatnonzero(own.track_source == k)
        in_leader = np.flatnonzero(leader.track_source == at.get((source.name, source.session), -1))
        _, i, j = np.intersect1d(own.track_id[in_own], leader.track_id[in_leader], return_indices=True)
        own_rows.append(in_own[i])
        leader_rows.append(in_leader[j])
    return _labels(own, np.concatenate(own_rows)), _labels(leader, np.concatenate(leader_rows))


def _labels(update: HypothesisUpdate, rows: Ints) -> Labels:
    labels: Labels = update.track_hypothesis[rows].astype(np.int64)
    labels[labels == UNDETERMINED] = -1
    return labels


def _origin(own: Hypothesis, leader: Hypothesis) -> _Origin:
    """Birth that clients know of one body, from its poses at one time since either birth."""
    if own.pose is None or leader.pose is None:
        return _Origin(leader.born_ns)
    return _Origin(leader.born_ns, transform(own.pose).inv() * transform(leader.pose))


def _since(pose: Pose, origin: _Origin) -> Pose:
    """The pose since the birth that clients know."""
    if origin.motion is None:
        return pose
    return pose_of(transform(pose) * origin.motion, len(pose.translation))


def _renamed(labels: NDArray[np.uint32], names: Mapping[int, int]) -> NDArray[np.uint32]:
    renamed = labels.copy()
    for own_id, name in names.items():
        renamed[labels == own_id] = name
    return renamed


def _event(event: Event, names: Mapping[int, int]) -> Event:
    return replace(event, hypothesis=names[event.hypothesis], others=[names[other] for other in event.others])
