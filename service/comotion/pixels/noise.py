"""Estimates the noise of each trajectory of a window, and finds gross errors of single observations.

Motion that the nearest trajectories share is neither: a camera that shakes moves all neighbours alike.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Bools, Floats, Slots, Stamps, nanmedian
from ..trajectories.window import Window

# Newest instants on which noise is estimated, and differences that the median of the source is worth.
_INSTANTS, _POOL = 12, 20
# Nearest trajectories whose median is subtracted, and the noise that remains with it: the variance of the
# median of five is .3 of that of one.
_NEAREST, _LESS_MEDIAN = 5, 1.3
# Median of a chi-squared variable with two degrees of freedom, per coordinate.
_CHI2_MEDIAN = 1.386
# Times the usual squared step from which on one is wild: some seven standard deviations; and px² of variance
# that is added.
_WILD, _LEAST_PX2 = 36.0, 0.25


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
    count, own = np.isfinite(square).sum(axis=0), nanmedian(square, 0) / _CHI2_MEDIAN
    source, pooled = window.source[slots], np.zeros(len(slots))
    for number in np.unique(source).tolist():
        pooled[source == number] = nanmedian(own[source == number], 0)
    estimated = np.nan_to_num((_POOL * pooled + count * np.nan_to_num(own)) / (_POOL + count))
    published = window.sigma[slots, window.stop[slots] - 1]
    return np.asarray(np.where(np.isnan(published), estimated, published**2))


def gross_errors(position: Floats, visible: Bools, variance: Floats) -> Bools:
    """Which observations leave their trajectory and come back, bool [F, n]: left out, they cost nothing.

    Steps of the trajectories nearby are no error. The step to one and the step from it cancel out.

    Parameters
    ----------
    position, visible
        float64 [F, n, 2] px and bool [F, n], at F instants, ascending.
    variance
        float64 [n], px²; noise of a coordinate.
    """
    errors = np.zeros(visible.shape, np.bool_)
    if len(visible) < 3:
        return errors
    last = len(visible) - 1 - visible[::-1].argmax(axis=0)
    step = np.diff(np.where(visible[..., None], position, np.nan), axis=0)
    excess, _ = _less_nearest(step, position[last, np.arange(len(last))])
    square = (excess**2).sum(axis=2)
    far = square > _WILD * np.fmax(nanmedian(square, 0), 2 * variance + _LEAST_PX2)
    back = ((excess[1:] + excess[:-1]) ** 2).sum(axis=2) < square[1:] / 4
    errors[1:-1] = far[1:] & far[:-1] & back
    errors[0], errors[-1] = far[0] & ~far[1], far[-1] & ~far[-2]
    return errors


def _squared_differences(window: Window, slots: Slots, stamps: Stamps) -> Floats:
    """Squared third divided differences at unit noise, px² [T - 3, n] or [1, n]; NaN where one is missing."""
    states = window.states_at(slots, stamps)
    place = np.where(states.observed[..., None], states.position, np.nan)
    difference = np.full((max(len(stamps) - 3, 1), len(slots), 2), np.nan)
    for k in range(len(stamps) - 3):
        times = (stamps[k : k + 4] - stamps[k]) * 1e-9
        intervals = times[:, None] - times + np.eye(4)
        weight = 1 / intervals.prod(axis=1)
        difference[k] = np.tensordot(weight / np.linalg.norm(weight), place[k : k + 4], axes=1)
    rows = np.flatnonzero(np.isfinite(difference[..., 0]).any(axis=0))
    newest = window.newest(slots[rows])
    remainder, shared = _less_nearest(difference[:, rows], newest)
    square = np.full(difference.shape[:2], np.nan)
    square[:, rows] = (remainder**2).sum(axis=2) / np.where(shared, _LESS_MEDIAN, 1)
    return square


def _less_nearest(values: Floats, place: Floats) -> tuple[Floats, Bools]:
    """Values [T, n, 2], NaN unknown, less the median of those nearest in place [n, 2], and where it is known.

    The median, as a neighbour may be in gross error.
    """
    if len(place) <= _NEAREST:
        return values, np.zeros(values.shape[:2], np.bool_)
    near = cKDTree(place).query(place, k=_NEAREST + 1)[1][:, 1:]
    shared = nanmedian(values[:, near], 2)
    has_shared = np.isfinite(shared)
    return values - np.where(has_shared, shared, 0.0), has_shared[..., 0]
