"""Joints between the hypotheses of all metric spaces, and their events.

Every pair of confirmed hypotheses that may touch is judged in turn, a few at an update. What is published of
a joint between two judgements follows from the poses and velocities of its hypotheses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from comotion_schemas import Event, Hypothesis, Joint
from comotion_schemas.hypotheses import EventKind, JointKind
from comotion_schemas.rigid import rotation, spin, three

from ..arrays import Floats
from ..config import JointsConfig
from ..partition import BodyMotion, SpaceSpec
from ..saving import NOT_KEPT
from ..space_update import SpaceUpdate
from .models import KINDS, joint_position
from .pair import Pair
from .states import States

Key = tuple[int, int]
# Between judgements: motion that shows joints takes longer than this, and updates must not.
_REST_NS, _NEVER_NS = 150_000_000, -(2**62)
# Pairs touch with a gap between their boxes up to this share of the extent of the larger of two moving
# bodies, and of the smaller where one rests.
_REACH = 0.5


@dataclass
class Joints:
    """Joints of all spaces, and their memory."""

    config: JointsConfig = field(metadata=NOT_KEPT)
    """How many pairs are judged together."""
    _pairs: dict[Key, Pair] = field(default_factory=dict)
    # When each was looked at last.
    _judged_ns: dict[Key, int] = field(default_factory=dict)

    def update(
        self, stamp_ns: int, updates: Sequence[SpaceUpdate], *, judging: bool = True
    ) -> tuple[list[Joint], list[Event]]:
        """Judge some pairs, unless `judging` is False, and describe all that may touch.

        Pairs of hypotheses that exist no more are forgotten.
        """
        spaces = []
        for part in updates:
            if part.spec.unit == "m" and self.config.pairs:
                listed = {h.id: h for h in part.bodies if h.confirmed and h.pose is not None}
                spaces.append((part, listed, _touching(listed)))
        due = self._due([key for *_, near in spaces for key in near], stamp_ns) if judging else []
        changes: dict[tuple[EventKind, int], list[int]] = {}
        joints = []
        for part, listed, near in spaces:
            chosen = [key for key in due if key in near]
            motions = part.motions({number for key in chosen for number in key}) if chosen else {}
            for key in (key for key in chosen if motions.keys() >= set(key)):
                self._judge(key, motions, listed, part.spec.name, changes)
            joints += [_describe(self._pairs[key], listed, part.spec) for key in near if key in self._pairs]
        existing = {h.id for part in updates for h in part.hypotheses}
        self._pairs = {key: pair for key, pair in self._pairs.items() if existing.issuperset(key)}
        self._judged_ns = {key: at for key, at in self._judged_ns.items() if existing.issuperset(key)}
        # One for each parent and kind, by which clients distinguish events.
        return joints, [
            Event(stamp_ns=stamp_ns, kind=kind, hypothesis=parent, others=children)
            for (kind, parent), children in changes.items()
        ]

    def _due(self, near: list[Key], stamp_ns: int) -> list[Key]:
        """The pairs that were judged longest ago, as many as there is time for."""
        if stamp_ns - max(self._judged_ns.values(), default=_NEVER_NS) < _REST_NS:
            return []
        due = sorted(near, key=lambda key: (self._judged_ns.get(key, _NEVER_NS), key))[: self.config.pairs]
        self._judged_ns |= dict.fromkeys(due, stamp_ns)
        return due

    def _judge(
        self,
        key: Key,
        motions: Mapping[int, BodyMotion],
        listed: Mapping[int, Hypothesis],
        space: str,
        changes: dict[tuple[EventKind, int], list[int]],
    ) -> None:
        """Judge a pair of a space, and take down what changes."""
        if key not in self._pairs:
            # What rests carries what moves, else the larger one the smaller.
            parent, child = sorted(key, key=lambda n: (not motions[n].static, -listed[n].size))
            self._pairs[key] = Pair.of(parent, child, space, motions[child].centre.copy())
        pair = self._pairs[key]
        last = pair.joint.kind
        pair.judge(motions[pair.joint.parent], motions[pair.joint.child])
        ends: tuple[tuple[EventKind, JointKind], ...] = (("released", last), ("joined", pair.joint.kind))
        for change, kind in ends if last != pair.joint.kind else ():
            if kind in KINDS:
                changes.setdefault((change, pair.joint.parent), []).append(pair.joint.child)


def _touching(listed: Mapping[int, Hypothesis]) -> list[Key]:
    """Pairs whose boxes are near each other."""
    boxes = {number: h.box for number, h in sorted(listed.items()) if h.box is not None}
    names = list(boxes)
    if len(names) < 2:
        return []
    centre = np.array([box.center for box in boxes.values()])
    turns, dim = [box.rotation for box in boxes.values()], centre.shape[1]
    turn = Rotation.from_quat(turns) if dim == 3 else Rotation.from_rotvec(np.outer(turns, [0, 0, 1]))
    axes = np.abs(turn.as_matrix()[:, :dim, :dim])
    half = np.einsum("nij,nj->ni", axes, [box.half for box in boxes.values()])
    size = 2 * np.linalg.norm(half, axis=1)
    gap = (np.abs(centre[:, None] - centre) - half[:, None] - half).clip(0)
    # Of a small part few places are seen: what it hangs on may be as far as the larger part is long.
    moving = np.array([listed[number].state != "static" for number in names])
    larger, smaller = np.maximum(size[:, None], size), np.minimum(size[:, None], size)
    margin = _REACH * np.where(moving[:, None] & moving, larger, smaller)
    near = np.argwhere(np.triu(np.linalg.norm(gap, axis=2) <= margin, 1))
    return [(names[i], names[j]) for i, j in near.tolist()]


def _describe(pair: Pair, listed: Mapping[int, Hypothesis], spec: SpaceSpec) -> Joint:
    """A joint as it is published."""
    joint, model = pair.joint, pair.model
    parent, child = listed[joint.parent], listed[joint.child]
    if model is None or joint.kind == "fixed" or parent.pose is None or child.pose is None:
        return joint
    R, t = rotation(parent.pose.rotation).as_matrix(), three(parent.pose.translation)
    # The state by the published poses; turn and place weigh like those of a frame.
    place = rotation(child.pose.rotation).as_matrix() @ pair.point + three(child.pose.translation)
    turn = R.T @ rotation(child.pose.rotation).as_matrix()
    p = R.T @ (place - t)
    state = States(np.zeros(1, np.int64), turn[None], p[None], pair.typical_information[None])
    axis, revolute = R @ model.u, model.kind == "revolute"
    # The point of the axis that is nearest to the child.
    point = R @ (model.c + model.u * (model.u @ (p - model.c)) if revolute else p) + t
    (spin_p, velocity_p), (spin_c, velocity_c) = _motion(parent, point), _motion(child, point)
    rate = float(axis @ (spin_c - spin_p if revolute else velocity_c - velocity_p))
    position, (low, high) = joint_position(model, state) - pair.zero, pair.range
    if spec.dim == 2 and revolute and axis[2] < 0:
        position, rate, low, high = -position, -rate, -high, -low
    return replace(
        joint,
        axis=None if spec.dim == 2 and revolute else axis[: spec.dim].tolist(),
        point=point[: spec.dim].tolist(),
        position=position,
        rate=rate,
        lower=min(low, position),
        upper=max(high, position),
    )


def _motion(body: Hypothesis, point: Floats) -> tuple[Floats, Floats]:
    """Angular velocity of a hypothesis, and velocity of its point that is at `point`, float64 [3] each."""
    if body.twist is None:
        return np.zeros(3), np.zeros(3)
    turning = spin(body.twist)
    return turning, three(body.twist.linear) + np.cross(turning, point - three(body.centroid))
