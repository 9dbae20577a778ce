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
from .procrustes import Body, pose_information
from .tracks import Tracks

# rad^-2, information of the prior: a turn that no point fixes is uncertain by a radian.
_FREE_TURN = 1.0
# m^-2 or the like: a centroid that no point fixes.
_LEAST_INFORMATION = 1e-12


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
        tolerance = (frames.tolerance / frames.independent)[rows]
        information = pose_information(frames, rows, body.template - body.template.mean(0), tolerance)
        turn = inverses(information[:, :3, :3] + _FREE_TURN * np.eye(3))
        path = body.R @ R.T, body.t - body.R @ R.T @ t
        spread = R @ turn @ R.T, 1 / np.maximum(information[:, 3, 3], _LEAST_INFORMATION)
    centre, radius = _shape(points)
    return BodyMotion(frames.stamps, *path, body.posed, *spread, centre, radius, body.static)


def _shape(points: Floats) -> tuple[Floats, float]:
    """Centroid of points [m, 3], and their root mean square distance from it."""
    if not len(points):
        return np.zeros(3), 0.0
    centre = points.mean(0)
    return centre, float(np.sqrt(((points - centre) ** 2).sum(1).mean()))
