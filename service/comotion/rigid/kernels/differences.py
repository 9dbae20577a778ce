"""Compiled: covariance of the noise of each trajectory, by contrasts of successive observations.

The contrast sum_j c_j x_j of four successive observations, with c_j proportional to
1 / prod_{k != j} (t_j - t_k) and sum_j c_j^2 = 1, vanishes on any quadratic motion whatever the
spacing. What is left is noise, with the covariance of one observation.
"""

import numpy as np

from ...arrays import Floats, Ints, Stamps
from ...compiled import compiled
from .records import Observations

# Squared difference that is wild, in medians: three standard deviations of normal noise. And the mean square
# of those that are wild in no direction, in variances.
_WILD, _BELOW_WILD = 9.0 / 0.4549364231195727, 0.96
# Most differences from which the noise of a trajectory is estimated, over its newest observations.
_MOST = 60
# Sum of the squared autocorrelations of third differences that begin one, two, three or more observations
# apart.
_OVERLAP = np.array([2.31, 1.18, 1.005, 1.0])


@compiled()
def difference_covariances(observations: Observations, gap: Stamps, chosen: Ints) -> tuple[Floats, Floats]:
    """Covariance of the noise: the mean square of third differences without the wild ones.

    A difference is wild if it is wild along an axis, or along the line between two. Each direction is judged
    by its own median: where the noise is not round, the median of a sum over coordinates would be wrong.
    They are evenly drawn from four times as many of the newest observations as are taken at most.

    Parameters
    ----------
    gap
        int64 [N], ns; no difference is taken across a longer one.
    chosen
        intp [n], the trajectories to take.

    Returns
    -------
    float64 [n, dim, dim] (0 where there is no difference) and [n], how many independent differences they are
    worth.
    """
    times, positions, start, stop = observations
    dim = positions.shape[1]
    covariance, count = np.zeros((len(chosen), dim, dim)), np.zeros(len(chosen))
    contrasts = np.empty((_MOST + 4, dim))
    for n in range(len(chosen)):
        i = chosen[n]
        seen = min(stop[i] - start[i], 4 * _MOST)
        step = max((seen - 3) // _MOST, 1)
        k = 0
        for m in range(stop[i] - 4, stop[i] - seen - 1, -step):
            if k < _MOST and _contrast(times, positions, m, gap[i], contrasts, k):
                k += 1
        # Few differences overlap less: of one, none does.
        count[n] = k * k / max(k + (_OVERLAP[min(step, 4) - 1] - 1) * (k - 1), 1.0)
        wildest = np.zeros(k)
        for a in range(dim if k > 0 else 0):
            for b in range(a, dim):
                squares = (contrasts[:k, a] + contrasts[:k, b]) ** 2
                wildest = np.maximum(wildest, squares / max(np.median(squares), 1e-300))
        kept = contrasts[:k][wildest <= _WILD]
        covariance[n] = kept.T @ kept / max(_BELOW_WILD * len(kept), 1e-300)
    return covariance, count


@compiled()
def _contrast(times: Stamps, positions: Floats, m: int, gap: int, contrasts: Floats, k: int) -> bool:
    """The normalised third divided difference of observations m to m + 3, to row k of [n, dim].

    False, and nothing is written, if they do not follow one another without a gap.
    """
    first, second, third = times[m + 1] - times[m], times[m + 2] - times[m + 1], times[m + 3] - times[m + 2]
    if min(first, second, third) <= 0 or max(first, second, third) > gap:
        return False
    # In units of the middle step, and times the product of all differences: the scale cancels.
    a, c = first / second, third / second
    whole = a + 1 + c
    c0, c1, c2, c3 = -c * (1 + c), c * (a + 1) * whole, -a * (1 + c) * whole, a * (a + 1)
    norm = 1 / np.sqrt(c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3)
    for d in range(positions.shape[1]):
        x0, x1, x2, x3 = positions[m, d], positions[m + 1, d], positions[m + 2, d], positions[m + 3, d]
        contrasts[k, d] = norm * (c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3)
    return True
