"""The window in; the noise of each trajectory out.

What the nearest trajectories do too is no noise: a camera that shakes moves all that is near in the same way.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Floats, Slots, Stamps
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window

# Newest instants on which noise is estimated, and differences that the median of the source is worth.
_INSTANTS, _POOL = 12, 20
# Nearest trajectories whose mean is taken away.
_NEAREST = 4
# Median of a chi-squared variable with two degrees of freedom, per coordinate.
_CHI2_MEDIAN = 1.386


def noise_variance(window: Window, slots: Slots, stamps: Sequence[int]) -> Floats:
    """Variance of a coordinate, px² [n]: a published one, else from third divided differences.

    That of a trajectory is the median of its own, drawn towards the median of its source.

    Parameters
    ----------
    window
        Store of all trajectories.
    slots
        intp [n].
    stamps
        ns, ascending; instants at which something was observed.
    """
    square = _squared_differences(window, slots, np.array(stamps[-_INSTANTS:], np.int64))
    count = np.isfinite(square).sum(axis=0)
    known, own = count > 0, np.zeros(len(slots))
    if known.any():
        # NaN come last: the median is in the middle of those before.
        ranked, middle = np.sort(square[:, known], axis=0), np.stack([count[known] - 1, count[known]]) // 2
        own[known] = np.take_along_axis(ranked, middle, axis=0).mean(axis=0) / _CHI2_MEDIAN
    variance = np.zeros(len(slots))
    for source in np.unique(window.source[slots]).tolist():
        mine = window.source[slots] == source
        pooled = float(np.median(own[mine & known])) if (mine & known).any() else 0.0
        variance[mine] = (_POOL * pooled + count[mine] * own[mine]) / (_POOL + count[mine])
    published = window.sigma[slots, window.stop[slots] - 1]
    return np.where(np.isfinite(published), published**2, variance)


def _squared_differences(window: Window, slots: Slots, stamps: Stamps) -> Floats:
    """Squared third divided differences at unit noise, px² [T - 3, n]; NaN where one is missing."""
    states = states_at(window, slots, stamps)
    place = np.where(states.observed[..., None], states.position, np.nan)
    difference = np.full((max(len(stamps) - 3, 0), len(slots), 2), np.nan)
    for k in range(len(difference)):
        times = (stamps[k : k + 4] - stamps[k]) * 1e-9
        apart = times[:, None] - times + np.eye(4)
        weight = 1 / apart.prod(axis=1)
        difference[k] = np.tensordot(weight / np.linalg.norm(weight), place[k : k + 4], axes=1)
    seen = np.isfinite(difference[..., 0])
    known = np.flatnonzero(seen.any(axis=0))
    if len(known) <= _NEAREST:
        return np.asarray((difference**2).sum(axis=2))
    newest = window.positions[slots[known], window.stop[slots[known]] - 1]
    near = np.full((len(slots), _NEAREST), known[0])
    near[known] = known[cKDTree(newest).query(newest, k=_NEAREST + 1)[1][:, 1:]]
    # A neighbour that is missing takes nothing away, and adds no noise.
    count = np.maximum(seen[:, near].sum(axis=2), 1)
    shared = np.where(seen[..., None], difference, 0.0)[:, near].sum(axis=2) / count[..., None]
    alone = ~seen[:, near].any(axis=2)
    return np.asarray(((difference - shared) ** 2).sum(axis=2) / np.where(alone, 1, 1 + 1 / count))
