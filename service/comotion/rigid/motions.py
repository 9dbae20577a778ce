"""Describes each body for publication (step 10): state, twist, noise and pose."""

from functools import partial

import numpy as np

from comotion_schemas import Pose
from comotion_schemas.hypotheses import HypothesisState

from ..arrays import Bools, Floats
from ..partition import Group, PoseReference
from .assignment import OUTLIER, SearchResult
from .frames import Frames
from .kinematics import Local, as_pose, as_twist, centroid_of, follow, local_motions
from .procrustes import Body
from .tracks import Tracks

# s; a hypothesis at rest is static only if it was observed for this long, as it may begin to move later.
_LEAST_STATIC_TIME = 1.0


def describe_bodies(tracks: Tracks, frames: Frames, result: SearchResult) -> list[Group]:
    """Describe every body of a search; one without a trajectory is left undetermined."""
    labels, bodies = result.assignment.labels, result.bodies
    current = np.where(tracks.current, labels, OUTLIER)
    memberships = [current == k for k in range(len(bodies))]
    points = [
        centroid_of(body, members[frames.owner], tracks.newest[members])
        for body, members in zip(bodies, memberships, strict=True)
    ]
    motions = local_motions(frames, bodies, int(frames.stamps[-1]), points)
    return [_described(frames, result, k, memberships[k], points[k], now) for k, now in enumerate(motions)]


def _described(
    frames: Frames, result: SearchResult, k: int, members: Bools, point: Floats, now: Local | None
) -> Group:
    """One body, of which current trajectories bool [N] are members, with its motion now."""
    body = result.bodies[k]
    if not (result.assignment.labels == k).any():
        return Group()
    pose_since = partial(_pose_since, frames, body, point, now)
    if not members.any():
        return Group(static=body.static, pose_since=pose_since)
    return Group(
        state=_state(frames, result, k),
        static=body.static,
        twist=None if now is None else as_twist(now.linear, now.angular, frames.dim),
        noise=_noise(result.evidence.squared[members[frames.owner], k], frames.dim),
        pose_since=pose_since,
    )


def _pose_since(
    frames: Frames, body: Body, point: Floats, now: Local | None, reference: PoseReference
) -> Pose | None:
    """Pose since birth; the reference is brought up to date."""
    if body.static:
        reference.stamp_ns = int(frames.stamps[-1])
    elif now is None:
        return None
    else:
        follow(reference, frames, body, now, lambda at: local_motions(frames, [body], at, [point])[0])
    return as_pose(reference.R, reference.t, frames.dim)


def _state(frames: Frames, result: SearchResult, k: int) -> HypothesisState:
    """Static or moving where the costs of its members tell, else undetermined."""
    members = result.assignment.labels == k
    if result.bodies[k].static:
        return "static" if frames.life[members].max(initial=0.0) >= _LEAST_STATIC_TIME else "undetermined"
    costs = result.evidence
    gain = float((costs.body[members, 0] - costs.body[members, k]).sum())
    return "moving" if gain > costs.restless[k] else "undetermined"


def _noise(squared: Floats, dim: int) -> float | None:
    """One-sigma residual of a coordinate of members by their mean squared residuals float64 [n]."""
    computed = squared[np.isfinite(squared)]
    return float(np.sqrt(computed.mean() / dim)) if len(computed) else None
