"""Groups of arrays as arguments of kernels: NamedTuples, which compiled code unpacks at no cost."""

from typing import NamedTuple

from ...arrays import Floats, Ints, Stamps


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
