"""Rates how well rest, or the motion of a group, explains the recent motion of each trajectory.

A gain is evidence in nat per update: 1 where the motion is explained, 0 at three standard deviations, and
negative beyond, down to a limit.
"""

import numpy as np

from ..arrays import Bools, Floats
from .kernels.motion import GATE, WORST, motion_gain
from .recent import Recent

# px; drift of a resting feature over each time scale, beside its noise. The first ones hold for bodies too.
_DRIFT_PX = np.array([0.3, 0.45, 0.8, 1.2])
BODY_SCALES = 2
"""Time scales over which bodies are compared: over longer ones they turn, and hands change their shape."""

# nat; median gain of its members from which on a body rests before a camera that moves.
_RESTS = 0.5


def rest_gain(recent: Recent, scales: int = len(_DRIFT_PX)) -> Floats:
    """Gain under rest, float64 [n]: the least over the first time scales, 0 if seen in none."""
    square, seen = (recent.displacement[:scales] ** 2).sum(axis=2), recent.seen[:scales]
    variance = 2 * (recent.variance + _DRIFT_PX[:scales, None] ** 2 + recent.tolerance[:scales])
    gain = np.where(seen, np.clip(1 - square / (GATE * variance), WORST, 1), 1.0)
    return np.where(seen.any(axis=0), gain.min(axis=0), 0.0)


def steadiness(recent: Recent) -> Floats:
    """How much each trajectory rests, float64 [n] from 0 to 1, the least over all time scales.

    What noise adds to a squared displacement is subtracted: in the mean over many, noise hides no motion.
    """
    surplus = (recent.displacement**2).sum(axis=2) - 4 * recent.variance
    width = 2 * GATE * (_DRIFT_PX[:, None] ** 2 + recent.tolerance)
    return np.asarray(np.where(recent.seen, np.clip(1 - surplus / width, 0, 1), 1.0).min(axis=0))


def group_gain(recent: Recent, members: Bools) -> Floats:
    """Gain of all trajectories under the motion of a group, float64 [n].

    Parameters
    ----------
    recent
        Of n trajectories.
    members
        bool [n].
    """
    lately = recent.displacement[:BODY_SCALES], recent.seen[:BODY_SCALES]
    gain, known = motion_gain(recent.position, *lately, recent.variance, _DRIFT_PX[:BODY_SCALES], members)
    if not known.any():
        # A group of which too little is seen may move in any way: rest is for it, and motion not against it.
        return np.maximum(rest_gain(recent), 0.0)
    # Before a camera that moves, rest is explained with more tolerance than a motion.
    if recent.tolerance.any():
        rest = rest_gain(recent, BODY_SCALES)
        if np.median(rest[members]) > _RESTS:
            return rest
    return gain
