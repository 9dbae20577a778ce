"""Groups of neighbours in; how well their affine local motions explain all trajectories out."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats32, Ints
from .kernels.affine import fit_local_motions, total_residuals
from .key_frames import FramePairs

RIDGE = 25.0
"""px²; regularisation of the affine motion of a group, per member."""

# px²; squared residual from which on it costs no more.
_CAP = 400.0


@dataclass(frozen=True)
class Residuals:
    """How H local motions explain N trajectories over Q frame pairs.

    Attributes
    ----------
    total
        float32 [H, N], px²; sum of the capped squared residuals.
    used
        float32 [H, Q]; 1 where a motion could be fitted.
    """

    total: Floats32
    used: Floats32


def explain(pairs: FramePairs, groups: list[Ints]) -> Residuals:
    """Fit every group's motion in every frame pair and apply it to all trajectories.

    Parameters
    ----------
    pairs
        Frame pairs of N trajectories.
    groups
        Members of local motions, each intp [H_r, M_r].
    """
    observed = pairs.start, pairs.displacement, pairs.seen
    parts = [fit_local_motions(*observed, group.T, RIDGE) for group in groups]
    motions, used = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    caps = used * np.float32(_CAP)
    return Residuals(
        total_residuals(*observed, motions, caps),
        np.ascontiguousarray(used.T),
    )
