"""Describes hypotheses of a carried frame relative to the world, and finds where the frame is.

The frame of a carried camera moves, so what is at rest moves in it. The world is the body that most of the
scene agrees on: the one with the most features, weighted with how widely they are spread. The first one must
have half of all features: before the motion separates bodies, a few features may be one by chance. It stays
the world while it has features and no other is clearly larger. With x(now) = W x(born) of the world in the
axes of the frame, the frame is at A W^-1 in the world, where A is where the frame was at the birth of that
hypothesis.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from comotion_schemas import Hypothesis, Pose, Twist
from comotion_schemas.rigid import pose_of, spin, three, transform

from .arrays import Floats, Labels
from .geometry.kinematics import as_twist
from .saving import NOT_KEPT

# Another body becomes the world if it is so many times larger.
_TIMES_LARGER = 2.0
# The first world has so large a share of the current features and has existed for so long, or is confirmed:
# in the first frames a camera that moves cannot be distinguished from one that rests.
_FIRST_SHARE, _FIRST_NS = 0.5, 400_000_000
# For how long frames are remembered: a hypothesis is born up to so long before it is listed.
_MEMORY_NS = 15_000_000_000


@dataclass
class MovingFrame:
    """The frame of one space over time: it moves as configured, else if all its sources say so."""

    dim: int = field(metadata=NOT_KEPT)
    """2 or 3."""
    metric: bool = field(metadata=NOT_KEPT)
    """Whether poses are in the unit of the space: without, only the states are known."""
    configured: bool | None = field(default=None, metadata=NOT_KEPT)
    """Whether it moves; None: as the sources say."""
    moving: bool = False
    """Whether it moves now."""
    declared: dict[int, tuple[str, bool]] = field(default_factory=dict, metadata=NOT_KEPT)
    """By session number its source, and whether that says that the frame moves."""
    contradicting: list[str] = field(default_factory=list, metadata=NOT_KEPT)
    """Sources that say so where not all do."""
    _world: int | None = None
    _anchor: RigidTransform = field(default_factory=RigidTransform.identity)
    _frame: RigidTransform = field(default_factory=RigidTransform.identity)
    _births: dict[int, RigidTransform] = field(default_factory=dict)
    _past: deque[tuple[int, RigidTransform]] = field(default_factory=deque, metadata=NOT_KEPT)
    # Before the first world: stamp, poses by hypothesis.
    _early: list[tuple[int, dict[int, RigidTransform]]] = field(default_factory=list, metadata=NOT_KEPT)

    def follow(self, present: list[int], in_use: set[int]) -> None:
        """Follow the declarations of sessions with current trajectories; forget those not in use."""
        claims = [self.declared[number] for number in present if number in self.declared]
        self.declared = {number: claim for number, claim in self.declared.items() if number in in_use}
        if self.configured is not None:
            self.moving = self.configured
        elif claims:
            self.moving = all(moving for _, moving in claims)
        self.contradicting = [name for name, moving in claims if moving and not self.moving]

    def relative(
        self, stamp_ns: int, hypotheses: list[Hypothesis], labels: Labels, positions: Floats
    ) -> tuple[list[Hypothesis], Pose | None]:
        """Describe hypotheses of the axes of the frame relative to the world; absent ones stay as they are.

        `stamp_ns` is the watermark; `labels` int64 [n] and `positions` float64 [n, dim] are those of the
        current trajectories. Returns the hypotheses, and x(world) = R x(frame) + t; None while the world has
        no pose, and where the frame rests.
        """
        if not self.moving:
            self._anchor = self._frame = RigidTransform.identity()
            self._world, self._births, self._past, self._early = None, {}, deque(), []
            return hypotheses, None
        present = {h.id: h for h in hypotheses if not h.absent}
        self._choose(stamp_ns, present, labels, positions)
        world = None if self._world is None else present.get(self._world)
        if self._world is None:
            poses = {number: transform(h.pose) for number, h in present.items() if h.pose is not None}
            self._early.append((stamp_ns, poses))
            self._early = [early for early in self._early if early[0] >= stamp_ns - _MEMORY_NS]
        pose = None if world is None else world.pose
        if pose is not None:
            self._frame = self._anchor * transform(pose).inv()
        self._past.append((stamp_ns, self._frame))
        while self._past[0][0] < stamp_ns - _MEMORY_NS:
            self._past.popleft()
        listed = {h.id for h in hypotheses}
        self._births = {number: born for number, born in self._births.items() if number in listed}
        for number in present.keys() - self._births.keys():
            born_ns = present[number].born_ns
            self._births[number] = min(self._past, key=lambda past: abs(past[0] - born_ns))[1]
        described = [h if h.absent else self._described(h, world) for h in hypotheses]
        return described, None if pose is None or not self.metric else pose_of(self._frame, self.dim)

    def _choose(
        self, stamp_ns: int, present: Mapping[int, Hypothesis], labels: Labels, positions: Floats
    ) -> None:
        """Keep the world, or take the largest body for it."""
        sizes = {
            number: _size(positions[labels == number])
            for number, h in present.items()
            if h.pose is not None or not self.metric
        }
        largest = max(sizes, key=lambda number: (sizes[number], -number), default=self._world)
        if largest is None or largest == self._world:
            return
        body = present[largest]
        if self._world is None and not body.confirmed:
            share = np.count_nonzero(labels == largest) / len(labels)
            if share < _FIRST_SHARE or stamp_ns - body.born_ns < _FIRST_NS:
                return
        if self._world in sizes and sizes[largest] < _TIMES_LARGER * sizes[self._world]:
            return
        # The place of the frame does not change with the body that is taken for the world.
        self._anchor = self._frame if body.pose is None else self._frame * transform(body.pose)
        if self._world is None:
            # Find where the frame was before.
            placed = [(stamp, poses[largest]) for stamp, poses in self._early if largest in poses]
            self._past = deque((stamp, self._anchor * pose.inv()) for stamp, pose in placed)
            self._births, self._early = {}, []
        self._world = largest

    def _described(self, body: Hypothesis, world: Hypothesis | None) -> Hypothesis:
        if body.id == self._world:
            still = None if body.twist is None else as_twist(np.zeros(3), np.zeros(3), self.dim)
            pose = None if body.pose is None else pose_of(RigidTransform.identity(), self.dim)
            return replace(body, state="static", pose=pose, twist=still)
        # A body at rest in the frame of a moving camera is carried with it.
        state = "moving" if body.state == "static" and world is not None else body.state
        if body.pose is None:
            return replace(body, state=state)
        moved = self._frame * transform(body.pose) * self._births[body.id].inv()
        return replace(
            body, state=state, pose=pose_of(moved, self.dim), twist=_relative_twist(body, world, self.dim)
        )


def _size(points: Floats) -> float:
    """Number of features times how widely they are spread."""
    if len(points) < 2:
        return 0.0
    return float(len(points) * np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _relative_twist(body: Hypothesis, world: Hypothesis | None, dim: int) -> Twist | None:
    """Velocities against the world, in the axes of the space."""
    if body.twist is None or world is None or world.twist is None:
        return body.twist
    lever = three(body.centroid) - three(world.centroid)
    turning = spin(world.twist)
    carried = three(world.twist.linear) + np.cross(turning, lever)
    return as_twist(three(body.twist.linear) - carried, spin(body.twist) - turning, dim)
