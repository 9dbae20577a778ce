"""Motion of hypotheses over the window, in axes that stay the same from update to update.

The axes of a body are new at every update. Those of a hypothesis are the axes of the space at its birth; its
pose reference gives the transform to them.
"""

from collections.abc import Mapping

import numpy as np

from ..arrays import Floats, inverses
from ..partition import BodyMotion, PoseReference
from .assignment import SearchResult
from .frames import Frames
from .procrustes import Body, align, pose_information
from .tracks import Tracks

# rad^-2, information of the prior: a turn that no point fixes is uncertain by a radian.
_FREE_TURN = 1.0
# m^-2 or the like: a centroid that no point fixes.
_LEAST_INFORMATION = 1e-12
# Fewest points that a body must share with a pose reference for its axes to be aligned.
_LEAST_SHARED = 3


def anchored_motions(
    tracks: Tracks, frames: Frames, result: SearchResult, references: Mapping[int, tuple[int, PoseReference]]
) -> dict[int, BodyMotion]:
    """Motion of some hypotheses; those whose axes cannot be determined are left out.

    Parameters
    ----------
    references
        By hypothesis: the index of its body, and its pose reference, brought up to date.
    """
    motions = {}
    for hypothesis, (k, reference) in references.items():
        body = result.bodies[k]
        if body.static:
            members = (result.assignment.labels == k) & tracks.current
            motion = _at_rest(frames, reference, tracks.newest[members])
        else:
            motion = _moving(frames, body, reference)
        if motion is not None:
            motions[hypothesis] = motion
    return motions


def _at_rest(frames: Frames, reference: PoseReference, newest: Floats) -> BodyMotion | None:
    count, (centre, radius) = len(frames.stamps), _shape((newest - reference.t) @ reference.R)
    return BodyMotion(
        stamps=frames.stamps,
        R=np.tile(reference.R, (count, 1, 1)),
        t=np.tile(reference.t, (count, 1)),
        posed=np.ones(count, np.bool_),
        turn_covariance=np.zeros((count, 3, 3)),
        place_variance=np.zeros(count),
        centre=centre,
        radius=radius,
        static=True,
    )


def _moving(frames: Frames, body: Body, reference: PoseReference) -> BodyMotion | None:
    shared, own, other = np.intersect1d(frames.names[body.rows], reference.rows, return_indices=True)
    if len(shared) < min(frames.dim, _LEAST_SHARED, len(body.rows)):
        return None
    # From the axes of the body to those of the hypothesis.
    R, t = align(body.template[own], reference.points[other], frames.dim)
    rows, template = body.rows, body.template - body.template.mean(0)
    tolerance = (frames.tolerance / frames.independent)[rows]
    information = pose_information(frames, rows, template, tolerance)
    turn = inverses(information[:, :3, :3] + _FREE_TURN * np.eye(3))
    turned = body.R @ R.T
    centre, radius = _shape(body.template @ R.T + t)
    return BodyMotion(
        stamps=frames.stamps,
        R=turned,
        t=body.t - turned @ t,
        posed=body.posed,
        turn_covariance=R @ turn @ R.T,
        place_variance=1 / np.maximum(information[:, 3, 3], _LEAST_INFORMATION),
        centre=centre,
        radius=radius,
        static=False,
    )


def _shape(points: Floats) -> tuple[Floats, float]:
    """Centroid of points [m, 3], and their root mean square distance from it."""
    if not len(points):
        return np.zeros(3), 0.0
    centre = points.mean(0)
    return centre, float(np.sqrt(((points - centre) ** 2).sum(1).mean()))
