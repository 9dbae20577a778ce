"""Joints between the hypotheses of all metric spaces, and their events.

Every pair of confirmed hypotheses that may touch is judged in turn, a few at an update. What is published of
a joint between two judgements follows from the poses and velocities of its hypotheses.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from comotion_schemas import Event, Hypothesis, Joint, Twist
from comotion_schemas.hypotheses import EventKind, JointKind
from comotion_schemas.rigid import rotation, spin, three

from ..arrays import Floats
from ..config import JointsConfig
from ..linking.linker import SpaceView
from ..partition import BodyMotion
from ..saving import NOT_KEPT
from .pair import JOINTS, Pair
from .states import States

Key = tuple[int, int]
MotionsOf = Callable[[Collection[int]], dict[int, BodyMotion]]
# Between judgements: motion that shows joints takes longer than this, and updates must not.
_REST_NS = 150_000_000
# Pairs touch with a gap between their boxes up to this share of the extent of the larger of two moving
# bodies, and of the smaller where one rests.
_REACH = 0.5


@dataclass(frozen=True)
class Place:
    """Pose since birth and velocities of a hypothesis: R [3, 3], t, linear, angular, centroid [3] each."""

    R: Floats
    t: Floats
    linear: Floats
    angular: Floats
    centroid: Floats

    @classmethod
    def of(cls, one: Hypothesis) -> "Place | None":
        """Of a hypothesis as it is published; None where it has no pose."""
        if one.pose is None:
            return None
        R, t = np.asarray(rotation(one.pose.rotation).as_matrix()), three(one.pose.translation)
        linear, angular = _velocities(one.twist)
        return cls(R, t, linear, angular, three(one.centroid))

    def velocity(self, x: Floats) -> Floats:
        """Velocity of the point of the body that is at x."""
        return np.asarray(self.linear + np.cross(self.angular, x - self.centroid))


@dataclass
class Joints:
    """Joints of all spaces, and their memory.

    Attributes
    ----------
    config
        How many pairs are judged together.
    """

    config: JointsConfig = field(metadata=NOT_KEPT)
    _pairs: dict[Key, Pair] = field(default_factory=dict)
    _judged_ns: int | None = None

    def update(
        self, stamp_ns: int, views: Sequence[SpaceView], *, judging: bool = True
    ) -> tuple[list[Joint], list[Event]]:
        """Judge some pairs, unless `judging` is False, and describe all that may touch."""
        found: list[Joint] = []
        events: list[Event] = []
        for view in views:
            if view.spec.unit == "m" and self.config.pairs:
                joints, changes = self._of_space(stamp_ns, view, view.motions if judging else None)
                found += joints
                events += changes
        return found, events

    def keep(self, hypotheses: Iterable[int]) -> None:
        """Forget the pairs of hypotheses that exist no more."""
        known = set(hypotheses)
        self._pairs = {key: pair for key, pair in self._pairs.items() if known.issuperset(key)}

    def _of_space(
        self, stamp_ns: int, view: SpaceView, motions_of: MotionsOf | None
    ) -> tuple[list[Joint], list[Event]]:
        listed = {h.id: h for h in view.hypotheses if h.confirmed and h.pose is not None}
        near = _touching(listed)
        rested = self._judged_ns is None or stamp_ns - self._judged_ns >= _REST_NS
        due = self._due(near, stamp_ns) if rested and motions_of is not None else []
        if due:
            self._judged_ns = stamp_ns
        motions = motions_of({one for key in due for one in key}) if due and motions_of is not None else {}
        events: list[Event] = []
        for key in due:
            if motions.keys() >= set(key):
                events += self._judge(key, motions, listed, stamp_ns)
            elif key in self._pairs:
                self._pairs[key].judged_ns = stamp_ns
        shown = [self._pairs[key] for key in near if key in self._pairs]
        return [_describe(pair, listed, view) for pair in shown], _merged(events)

    def _due(self, near: list[Key], stamp_ns: int) -> list[Key]:
        """The pairs that were judged longest ago, as many as there is time for."""

        def waiting(key: Key) -> tuple[int, Key]:
            last = self._pairs[key].judged_ns if key in self._pairs else None
            return (-(2**62) if last is None else last - stamp_ns, key)

        return sorted(near, key=waiting)[: self.config.pairs]

    def _judge(
        self, key: Key, motions: dict[int, BodyMotion], listed: dict[int, Hypothesis], stamp_ns: int
    ) -> list[Event]:
        pair = self._pairs.get(key)
        if pair is None:
            parent, child = _roles(key, motions, listed)
            pair = self._pairs[key] = Pair(parent, child, motions[child].centre.copy())
        before = pair.known.kind
        pair.judge(motions[pair.parent], motions[pair.child])
        now = pair.known.kind
        if before == now:
            return []
        changes: list[tuple[EventKind, JointKind]] = [("released", before), ("joined", now)]
        return [
            Event(stamp_ns=stamp_ns, kind=change, hypothesis=pair.parent, others=[pair.child])
            for change, kind in changes
            if kind in JOINTS
        ]


def _merged(events: list[Event]) -> list[Event]:
    """One event for each parent and kind: by which clients distinguish events."""
    found: dict[tuple[str, int], Event] = {}
    for event in events:
        name = event.kind, event.hypothesis
        known = found.get(name)
        found[name] = event if known is None else replace(known, others=known.others + event.others)
    return list(found.values())


def _roles(key: Key, motions: dict[int, BodyMotion], listed: dict[int, Hypothesis]) -> Key:
    """Parent and child: what rests carries what moves, else the larger one the smaller."""
    a, b = key
    if motions[a].static != motions[b].static:
        return (a, b) if motions[a].static else (b, a)
    return (a, b) if listed[a].size >= listed[b].size else (b, a)


def _touching(listed: Mapping[int, Hypothesis]) -> list[Key]:
    """Pairs whose boxes are near each other."""
    boxes = {one: h.box for one, h in sorted(listed.items()) if h.box is not None}
    names = list(boxes)
    if len(names) < 2:
        return []
    turns = [box.rotation for box in boxes.values()]
    flat = not isinstance(turns[0], list)
    turn = Rotation.from_rotvec(np.outer(turns, [0, 0, 1])) if flat else Rotation.from_quat(turns)
    centre = np.array([box.center for box in boxes.values()])
    axes = np.abs(turn.as_matrix()[:, : centre.shape[1], : centre.shape[1]])
    half = np.einsum("nij,nj->ni", axes, [box.half for box in boxes.values()])
    size = 2 * np.linalg.norm(half, axis=1)
    gap = (np.abs(centre[:, None] - centre) - half[:, None] - half).clip(0)
    # Of a small part few places are seen: what it hangs on may be as far as the larger part is long.
    moving = np.array([listed[one].state != "static" for one in names])
    larger, smaller = np.maximum(size[:, None], size), np.minimum(size[:, None], size)
    margin = _REACH * np.where(moving[:, None] & moving, larger, smaller)
    near = np.argwhere(np.triu(np.linalg.norm(gap, axis=2) <= margin, 1))
    return [(names[i], names[j]) for i, j in near.tolist()]


def _describe(pair: Pair, listed: Mapping[int, Hypothesis], view: SpaceView) -> Joint:
    """A joint as it is published."""
    confidence = min(max(pair.known.confidence, 0.0), 1.0)
    joint = Joint(
        parent=pair.parent,
        child=pair.child,
        space=view.spec.name,
        kind=pair.known.kind,
        confidence=confidence,
    )
    model, sigmas = pair.model, pair.known.sigmas
    if model is None or sigmas is None:
        return joint
    parent, child = Place.of(listed[pair.parent]), Place.of(listed[pair.child])
    if parent is None or child is None:
        return joint
    state = _state_now(pair, parent, child)
    axis = parent.R @ model.u
    revolute = model.kind == "revolute"
    # The point of the axis that is nearest to the child.
    near = model.c + model.u * (model.u @ (state.p[0] - model.c)) if revolute else state.p[0]
    point = parent.R @ near + parent.t
    if revolute:
        rate = float(axis @ (child.angular - parent.angular))
    else:
        rate = float(axis @ (child.velocity(point) - parent.velocity(point)))
    position, (low, high) = pair.position(state), pair.range
    if view.spec.dim == 2 and revolute and axis[2] < 0:
        position, rate, low, high = -position, -rate, -high, -low
    return replace(
        joint,
        axis=None if view.spec.dim == 2 and revolute else axis[: view.spec.dim].tolist(),
        point=point[: view.spec.dim].tolist(),
        position=position,
        rate=rate,
        lower=min(low, position),
        upper=max(high, position),
        sigma_axis=sigmas.axis,
        sigma_point=sigmas.point,
        sigma_position=sigmas.position,
        sigma_rate=sigmas.rate,
    )


def _state_now(pair: Pair, parent: Place, child: Place) -> States:
    """The state of a pair by its published poses; turn and place weigh like those of a frame."""
    R = parent.R.T @ child.R
    p = parent.R.T @ (child.R @ pair.point + child.t - parent.t)
    return States(np.zeros(1, np.int64), R[None], p[None], pair.typical_information[None])


def _velocities(twist: Twist | None) -> tuple[Floats, Floats]:
    if twist is None:
        return np.zeros(3), np.zeros(3)
    return three(twist.linear), spin(twist)
