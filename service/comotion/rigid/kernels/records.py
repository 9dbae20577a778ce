"""Groups of arrays as arguments of kernels: NamedTuples, which compiled code unpacks at no cost."""

from typing import NamedTuple

from ...arrays import Bools, Floats, Ints, Stamps

ROUND = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""Metric of noise that is the same in all directions."""


class Observations(NamedTuple):
    """Observations of N trajectories, those of trajectory i in [start[i]:stop[i]].

    `times` int64 [M] ns, `positions` float64 [M, dim], `start` and `stop` intp [N].
    """

    times: Stamps
    positions: Floats
    start: Ints
    stop: Ints


class Limits(NamedTuple):
    """Where N trajectories are interpolated, int64 [N] ns each.

    Nothing across a gap longer than `gap`; by extension up to `hold` beyond the newest observation; after
    adding `delay` to the times.
    """

    gap: Stamps
    hold: Stamps
    delay: Stamps


class RowArrays(NamedTuple):
    """P rows on F frames: `y` float64 [P, F, 3], `w` [P, F] (0: unobserved), `tolerance` [P].

    `spectrum` float64 [P, 3] are the white and the slow part of the noise, in tolerances, and the correlation
    of the slow part from frame to frame. `metric` float64 [P, 6] is the inverse covariance in units of the
    inverse tolerance: xx, xy, xz, yy, yz, zz; that of :data:`ROUND` where the noise is the same in all
    directions.
    """

    y: Floats
    w: Floats
    tolerance: Floats
    spectrum: Floats
    metric: Floats


class PoseArrays(NamedTuple):
    """Poses x = R b + t of a body: `R` float64 [F, 3, 3], `t` float64 [F, 3], `posed` bool [F]."""

    R: Floats
    t: Floats
    posed: Bools
