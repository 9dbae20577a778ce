"""Hypotheses as they are published: centroid, state, pose since birth, twist and noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis
from comotion_schemas.hypotheses import HypothesisState

from ..arrays import Ints, Stamps
from ..partition import NO_HYPOTHESIS
from .bodies import Body, residuals
from .config import MotionConfig
from .frames import Frames
from .kinematics import Anchor, Local, as_pose, as_twist, centroid_of, follow, local_motion
from .search import Found
from .tracks import Tracks

# A scene must have been watched this long before "nothing moves" says more than "nothing yet".
_WATCHED = 1.0
# The noise of a hypothesis is read off so many of its members, evenly drawn.
_ASKED = 64
# Rows of one trajectory are told apart in an anchor by this stride.
_ROWS_PER_TRACK = 8


class Describer:
    """Keeps the birth of each hypothesis, to tell its pose since."""

    def __init__(self, space: str, config: MotionConfig) -> None:
        self._space = space
        self._config = config
        self._anchors: dict[int, Anchor] = {}

    def describe(
        self, tracks: Tracks, frames: Frames, found: Found, ids: NDArray[np.int64]
    ) -> list[Hypothesis]:
        """Hypotheses that have a living member, by id."""
        names = _row_names(tracks, frames)
        listed: list[Hypothesis] = []
        kept: dict[int, Anchor] = {}
        for k, (body, one) in enumerate(zip(found.bodies, ids.tolist(), strict=True)):
            if one == NO_HYPOTHESIS:
                continue
            kept[one] = self._anchors.get(one) or Anchor.new(int(frames.stamps[-1]))
            members = np.flatnonzero((found.assignment.labels == k) & tracks.alive)
            motion = self._motion(tracks, frames, body, members, names, kept[one])
            if len(members):
                listed.append(self._hypothesis(one, k, tracks, frames, found, members, kept[one], motion))
        self._anchors = kept
        return sorted(listed, key=lambda h: h.id)

    def _motion(
        self, tracks: Tracks, frames: Frames, body: Body, members: Ints, names: Stamps, anchor: Anchor
    ) -> Local | None:
        """Motion now; the anchor is brought up to date."""
        if body.static:
            anchor.stamp_ns = int(frames.stamps[-1])
            return Local(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        point = centroid_of(body, frames.rows_of(members), tracks.newest()[members])
        now = local_motion(frames, body, int(frames.stamps[-1]), point)
        if now is not None:
            mine = names[body.rows]
            follow(anchor, frames, body, mine, now, lambda at: local_motion(frames, body, at, point))
        return now

    def _hypothesis(
        self,
        one: int,
        k: int,
        tracks: Tracks,
        frames: Frames,
        found: Found,
        members: Ints,
        anchor: Anchor,
        motion: Local | None,
    ) -> Hypothesis:
        body = found.bodies[k]
        dim = frames.dim
        return Hypothesis(
            id=one,
            space=self._space,
            size=len(members),
            born_ns=anchor.born_ns,
            state=self._state(frames, found, k),
            centroid=tracks.newest()[members, :dim].mean(0).tolist(),
            pose=None if motion is None else as_pose(anchor.R, anchor.t, dim),
            twist=None if motion is None else as_twist(motion.linear, motion.angular, dim),
            noise=_noise(frames, body, frames.rows_of(members), self._config),
        )

    def _state(self, frames: Frames, found: Found, k: int) -> HypothesisState:
        """Static or moving where the costs of its members tell, else undetermined."""
        members = found.assignment.labels == k
        if found.bodies[k].static:
            watched = frames.life[members].max(initial=0) / self._config.frame_rate
            return "static" if watched >= _WATCHED else "undetermined"
        costs = found.evidence
        gain = float((costs.body[members, 0] - costs.body[members, k]).sum())
        return "moving" if gain > costs.opening[k] else "undetermined"

    def state(self) -> list[list[Any]]:
        """As plain values and arrays."""
        return [[one, anchor.state()] for one, anchor in self._anchors.items()]

    def load(self, state: list[list[Any]]) -> None:
        """Take up :meth:`state`."""
        self._anchors = {int(one): Anchor(**values) for one, values in state}


def _row_names(tracks: Tracks, frames: Frames) -> Stamps:
    """A stable name for each row: its trajectory's key and its place among that one's rows, int64 [P]."""
    order = np.argsort(frames.owner, kind="stable")
    owner = frames.owner[order]
    place = np.zeros(len(owner), np.int64)
    place[order] = np.arange(len(owner)) - np.searchsorted(owner, owner)
    return tracks.key[frames.owner] * _ROWS_PER_TRACK + place


def _noise(frames: Frames, body: Body, rows: Ints, config: MotionConfig) -> float:
    """One-sigma residual of a coordinate of the members."""
    some = rows[:: -(-len(rows) // _ASKED)]
    return float(np.sqrt(residuals(frames, body, some, config).mean() / frames.dim))
