"""In bodies and their members, out what is published of each (step 10): state, twist, noise and pose."""

from collections.abc import Callable
from functools import partial

import numpy as np

from comotion_schemas import Pose
from comotion_schemas.hypotheses import HypothesisState

from ..arrays import Floats
from ..partition import Group, PoseReference
from .assignment import SearchResult
from .kinematics import Local, as_pose, as_twist, centroid_of, follow, local_motion
from .procrustes import Body
from .resampling import Frames
from .tracks import Tracks

# s; a hypothesis at rest is static only if it was observed for so long, as what will move may rest at first.
_LEAST_STATIC_TIME = 1.0


def describe_bodies(tracks: Tracks, frames: Frames, found: SearchResult) -> list[Group]:
    """Describe every body of a search; one without a trajectory is left undetermined."""
    labels = found.assignment.labels
    groups = []
    for k in range(len(found.bodies)):
        members = labels == k
        groups.append(_describe(tracks, frames, found, k) if members.any() else Group())
    return groups


def _describe(tracks: Tracks, frames: Frames, found: SearchResult, k: int) -> Group:
    body = found.bodies[k]
    members = np.flatnonzero((found.assignment.labels == k) & tracks.current)
    rows = frames.rows_of(members)
    point = np.zeros(3) if body.static else centroid_of(body, rows, tracks.newest[members])
    now = _motion(frames, body, point)
    since: Callable[[PoseReference], Pose | None] = partial(_pose_at_rest, frames)
    if not body.static:
        since = partial(_pose_since, frames, body, point, now)
    if not len(members):
        return Group(static=body.static, pose_since=since)
    return Group(
        state=_state(frames, found, k),
        static=body.static,
        twist=None if now is None else as_twist(now.linear, now.angular, frames.dim),
        noise=_noise(found.evidence.squared[rows, k], frames.dim),
        pose_since=since,
    )


def _motion(frames: Frames, body: Body, point: Floats) -> Local | None:
    """Motion at the newest frame."""
    if body.static:
        return Local(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
    return local_motion(frames, body, int(frames.stamps[-1]), point)


def _pose_at_rest(frames: Frames, reference: PoseReference) -> Pose:
    reference.stamp_ns = int(frames.stamps[-1])
    return as_pose(reference.R, reference.t, frames.dim)


def _pose_since(
    frames: Frames, body: Body, point: Floats, now: Local | None, reference: PoseReference
) -> Pose | None:
    """Pose since birth; the reference is brought up to date."""
    if now is None:
        return None
    follow(reference, frames, body, now, lambda at: local_motion(frames, body, at, point))
    return as_pose(reference.R, reference.t, frames.dim)


def _state(frames: Frames, found: SearchResult, k: int) -> HypothesisState:
    """Static or moving where the costs of its members tell, else undetermined."""
    members = found.assignment.labels == k
    if found.bodies[k].static:
        return "static" if frames.life[members].max(initial=0.0) >= _LEAST_STATIC_TIME else "undetermined"
    costs = found.evidence
    gain = float((costs.body[members, 0] - costs.body[members, k]).sum())
    return "moving" if gain > costs.restless[k] else "undetermined"


def _noise(squared: Floats, dim: int) -> float | None:
    """One-sigma residual of a coordinate of members by their mean squared residuals float64 [n]."""
    known = squared[np.isfinite(squared)]
    return float(np.sqrt(known.mean() / dim)) if len(known) else None
