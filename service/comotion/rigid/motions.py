"""Describes each body for publication (step 10): state, twist, noise, pose, and motion over the window.

The axes of a body are new at every update. Those of a hypothesis are the axes of the space at its birth; its
pose reference gives the transform to them.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from comotion_schemas import Pose
from comotion_schemas.hypotheses import HypothesisState

from ..arrays import Bools, Floats, inverses
from ..geometry.body import Body, pose_information
from ..geometry.frames import SETTLED, Frames
from ..geometry.kinematics import Local, as_pose, as_twist, centroid_of, follow, local_motions
from ..partition import BodyMotion, Group, PoseReference
from .assignment import OUTLIER, SearchResult
from .tracks import Tracks

# m^-2 or the like: a centroid that no point fixes.
_LEAST_INFORMATION = 1e-12


def describe_bodies(tracks: Tracks, frames: Frames, result: SearchResult) -> list[Group]:
    """Describe every body of a search; one without a trajectory is left undetermined."""
    labels, bodies = result.assignment.labels, result.bodies
    current = np.where(tracks.current, labels, OUTLIER)
    memberships = [current == k for k in range(len(bodies))]
    points = [
        centroid_of(body, tracks.newest[members]) for body, members in zip(bodies, memberships, strict=True)
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
    if result.bodies[k].static:
        # What has been observed for less may begin to move.
        seen = frames.life[result.assignment.labels == k].max(initial=0.0)
        return "static" if seen >= SETTLED else "undetermined"
    return "moving" if result.gains[k, 0] > result.evidence.opening[k] else "undetermined"


def _noise(squared: Floats, dim: int) -> float | None:
    """One-sigma residual of a coordinate of members by their mean squared residuals float64 [n]."""
    computed = squared[np.isfinite(squared)]
    return float(np.sqrt(computed.mean() / dim)) if len(computed) else None


def anchored_motions(
    tracks: Tracks, frames: Frames, result: SearchResult, references: Mapping[int, tuple[int, PoseReference]]
) -> dict[int, BodyMotion]:
    """Motion of some hypotheses; those whose axes are not known are left out.

    Parameters
    ----------
    references
        By hypothesis: the index of its body, and its pose reference, brought up to date.
    """
    motions = {}
    for hypothesis, (k, reference) in references.items():
        members = (result.assignment.labels == k) & tracks.current
        motion = _motion(frames, result.bodies[k], reference, tracks.newest[members])
        if motion is not None:
            motions[hypothesis] = motion
    return motions


def _motion(frames: Frames, body: Body, reference: PoseReference, newest: Floats) -> BodyMotion | None:
    """Motion of one body, the shape of which is that of its members now, float64 [n, 3], if it is static."""
    count = len(frames.stamps)
    if body.static:
        path = np.tile(reference.R, (count, 1, 1)), np.tile(reference.t, (count, 1))
        spread, points = (np.zeros((count, 3, 3)), np.zeros(count)), (newest - reference.t) @ reference.R
    elif reference.axes is None or reference.axes[0] is not body.template:
        return None
    else:
        # From the axes of the body to those of the hypothesis.
        _, R, t = reference.axes
        rows, points = body.rows, body.template @ R.T + t
        tolerance = frames.tolerance[rows] / frames.independent(rows)
        information = pose_information(frames, rows, body.template - body.template.mean(0), tolerance)
        # A turn that no point fixes is uncertain by a radian.
        turn = inverses(information[:, :3, :3] + np.eye(3))
        path = body.R @ R.T, body.t - body.R @ R.T @ t
        spread = R @ turn @ R.T, 1 / np.maximum(information[:, 3, 3], _LEAST_INFORMATION)
    centre = points.mean(0) if len(points) else np.zeros(3)
    radius = float(np.sqrt(((points - centre) ** 2).sum(1).mean()) if len(points) else 0.0)
    return BodyMotion(frames.stamps, *path, body.posed, *spread, centre, radius, body.static)
