"""Lowers the confidence in trajectories that no body explains.

A body explains what its members do when its residual is small against the size of the scene. Ids that change
hands, random numbers and the like are grouped too, with residuals of a fifth of the scene and more; among
them some small group fits by chance. So the confidence in a trajectory falls with the residual of its own
hypothesis, and with the share of the trajectories of its source that are explained.

The residual is below .02 of the size of the scene for bodies of metal and below .1 for markers on people (the
recordings of docs/research/unseen.md); with ids that roll by one it is .3 to 1.
"""

from collections.abc import Sequence

import numpy as np

from comotion_schemas import Hypothesis

from ..arrays import Floats, Ints, Labels, distinct, find

# Residual, as a share of the size of the scene, that halves the confidence.
_HALF = 0.15


def explained(labels: Labels, hypotheses: Sequence[Hypothesis], positions: Floats, sessions: Ints) -> Floats:
    """Factors of the confidence.

    Parameters
    ----------
    labels
        int64 [n], hypothesis of each trajectory, -1 without one.
    hypotheses
        Those of the space, with their noise where it is known.
    positions
        float64 [n, 3], newest ones; NaN in the third column in 2-D.
    sessions
        intp [n], session number of each trajectory.

    Returns
    -------
    float64 [n] in 0..1; 1 where no noise is known.
    """
    noise = {one.id: one.noise for one in hypotheses if one.noise}
    if not noise or not len(labels):
        return np.ones(len(labels))
    away = positions - np.median(positions, axis=0)
    # Per axis, as the noise is.
    size = np.sqrt(np.nanmean(np.square(away), axis=1))
    scale = max(float(np.median(size)), 1e-12)
    known = np.array(sorted(noise), np.int64)
    share = np.append([noise[one] for one in known.tolist()], 0.0)[find(labels, known)] / scale
    own = 1 / (1 + (share / _HALF) ** 4)
    _, numbers = distinct(sessions)
    return np.asarray(own * (np.bincount(numbers, own) / np.bincount(numbers))[numbers], np.float64)
