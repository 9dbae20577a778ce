"""Gives a standby's updates the ids that the active service publishes.

A standby fuses the same observations as the active service, but both give ids in the order in which they
find bodies. So the standby compares its own updates with the published ones: hypotheses that share most
trajectories are the same body. When it takes over, it publishes under the ids that clients know.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from comotion_schemas import UNDETERMINED, Event, Hypothesis, HypothesisUpdate
from comotion_schemas.rigid import pose_of, transform

from .arrays import find
from .hypotheses.identity import ID_GAP, IdAllocator
from .hypotheses.registry import EVENT_MEMORY_NS
from .matching import largest_total, shared_counts
from .saving import NOT_KEPT

# ns; so long after its last update the bodies of another service are recognised by their trajectories.
_TAKEOVER_NS = 10_000_000_000


@dataclass(frozen=True)
class _Published:
    """What clients know a hypothesis as: its id, and its birth where that was under another service.

    `motion` leads from there to the birth in this service; None where unknown.
    """

    id: int
    born_ns: int | None = None
    motion: RigidTransform | None = None


@dataclass
class PublishedIds:
    """The ids and births under which the hypotheses of this service are published.

    Those are its own until it follows an active service.
    """

    _published: dict[int, _Published] = field(default_factory=dict)
    ids: IdAllocator | None = None
    """Gives out ids for hypotheses that have not been published yet; None: it has not followed any
    service."""
    _leader: HypothesisUpdate | None = field(default=None, metadata=NOT_KEPT)

    def follow(self, own: HypothesisUpdate, leader: HypothesisUpdate) -> None:
        """Take over the ids of what the active service has published.

        `own` is the last update of this service, with its own ids; that of the leader has about the same
        watermark.
        """
        highest = max((h.id for h in leader.hypotheses), default=0)
        # The leader may have given out ids in updates that were lost with it.
        following = 1 if self.ids is None else self.ids.following
        self.ids = IdAllocator(max(following, highest + ID_GAP))
        self._leader = leader
        self._take_over(own, leader, {h.id for h in own.hypotheses if not h.absent})

    def apply(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """An update of this service with the ids, births and events that clients know."""
        if self.ids is None:
            return update
        leader, led_until_ns, events = self._leader, 0, list[Event]()
        if leader is not None:
            led_until_ns, events = leader.stamp_ns, leader.events
            if update.stamp_ns - led_until_ns <= _TAKEOVER_NS:
                present = {h.id for h in update.hypotheses if not h.absent}
                self._take_over(update, leader, present - set(self._published))
        in_events = ((e.hypothesis, *e.others) for e in update.events)
        numbers = sorted({h.id for h in update.hypotheses}.union(*in_events))
        names = {number: self.name(number) for number in numbers}
        recent = [e for e in update.events if e.stamp_ns > led_until_ns]
        oldest_ns = update.stamp_ns - EVENT_MEMORY_NS
        labels = update.track_hypothesis.copy()
        for number, name in names.items():
            labels[update.track_hypothesis == number] = name
        return replace(
            update,
            track_hypothesis=labels,
            hypotheses=sorted(map(self._renamed, update.hypotheses), key=lambda h: h.id),
            joints=[replace(j, parent=names[j.parent], child=names[j.child]) for j in update.joints],
            events=[e for e in events if e.stamp_ns >= oldest_ns]
            + [
                replace(e, hypothesis=names[e.hypothesis], others=[names[other] for other in e.others])
                for e in recent
            ],
        )

    def own(self, published: int) -> int | None:
        """The id inside this service of a published one."""
        entries = self._published.items()
        return next((n for n, entry in entries if entry.id == published), None) if self.ids else published

    def name(self, own_id: int) -> int:
        """The published id of a hypothesis; a fresh one if it has none."""
        if self.ids is None:
            return own_id
        if own_id not in self._published:
            self._published[own_id] = _Published(self.ids.next())
        return self._published[own_id].id

    def _take_over(self, own: HypothesisUpdate, leader: HypothesisUpdate, unnamed: set[int]) -> None:
        """Publish some hypotheses as the leader does, as far as it knows them."""
        own_bodies, leading = {h.id: h for h in own.hypotheses}, {h.id: h for h in leader.hypotheses}
        last = self._published
        published = {n: p for n, p in last.items() if n not in unnamed or p.id not in leading}
        in_use = {published[n].id for n, h in own_bodies.items() if n in published and not h.absent}
        pairs = {
            number: name
            for number, name in (same_bodies(own, leader).items() if unnamed else ())
            if number in unnamed and name not in in_use
        }
        self._published = {n: p for n, p in published.items() if p.id not in pairs.values()}
        for number, name in pairs.items():
            entry, born_ns = last.get(number), leading[name].born_ns
            if entry is not None and entry.born_ns == born_ns and own.stamp_ns != leader.stamp_ns:
                self._published[number] = replace(entry, id=name)
            else:
                pose, led, motion = own_bodies[number].pose, leading[name].pose, None
                if pose is not None and led is not None:
                    motion = transform(pose).inv() * transform(led)
                self._published[number] = _Published(name, born_ns, motion)

    def _renamed(self, body: Hypothesis) -> Hypothesis:
        entry, pose, linked = self._published[body.id], body.pose, body.linked
        if pose is not None and entry.motion is not None:
            pose = pose_of(transform(pose) * entry.motion, len(pose.translation))
        return replace(
            body,
            id=entry.id,
            born_ns=body.born_ns if entry.born_ns is None else entry.born_ns,
            pose=pose,
            linked=None if linked is None else sorted(map(self.name, linked)),
        )


def same_bodies(own: HypothesisUpdate, leader: HypothesisUpdate) -> dict[int, int]:
    """Hypotheses of two updates of one scene that share most trajectories, {id in own: id in leader}.

    The assignment with most shared trajectories in all (Kuhn 1955), among hypotheses of the same space.
    """
    # The hypotheses in both of the trajectories that are in both, negative for none.
    pairs: list[tuple[int, int]] = []
    for source in own.sources:
        led = leader.hypotheses_of(source.name, source.session)
        tracks = own.hypotheses_of(source.name, source.session).items()
        pairs += [(label, led[track]) for track, label in tracks if track in led]
    labels = np.array(pairs, np.int64).reshape(-1, 2)
    labels[labels == UNDETERMINED] = -1
    leading = sorted(leader.hypotheses, key=lambda h: h.id)
    columns = find(labels[:, 1], np.array([h.id for h in leading], np.int64))
    own_ids, shared = shared_counts(labels[:, 0], columns, len(leading))
    space = {h.id: h.space for h in own.hypotheses}
    spaces = np.array([h.space for h in leading], object)
    for row, own_id in enumerate(own_ids.tolist()):
        shared[row, spaces != space[own_id]] = 0
    return {int(own_ids[row]): leading[column].id for row, column in largest_total(shared)}
