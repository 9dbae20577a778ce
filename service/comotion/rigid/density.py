"""Kernel density of a body's members in space."""

import numpy as np

from ..arrays import Floats, Ints
from ..compiled import compiled

# Smallest variance of a density in any direction, as a share of all.
_FLATTEST = 1e-9
# So many members, evenly drawn from all, stand for a density; so many points for the spacing of all.
_MEMBERS = 128
_ASKED = 256
# Beyond this squared distance in bandwidths a kernel is below the smallest number added to their sum.
_NOTHING = 1400.0


def spacing(x: Floats) -> float:
    """Median squared distance of points [n, dim] to the nearest neighbour."""
    if len(x) < 2:
        return 1.0
    return max(float(np.median(_nearest(x, _thinned(np.arange(len(x)), _ASKED)))), 1e-18)


def log_density(x: Floats, asked: Ints, members: Ints, voice: Floats, spacing: float) -> Floats:
    """Log of the kernel density of members at x[asked], each left out of its own, float64 [n].

    The kernel has the shape of the body's own spread, drawn to the scene's spacing where members are
    few, and Scott's bandwidth n^(-1/(dim + 4)).

    Parameters
    ----------
    x
        float64 [N, dim].
    asked, members
        intp [n] and [m], indices into x.
    voice
        float64 [m], weights of the members.
    """
    dim = x.shape[1]
    total = voice.sum()
    z = x[members] - (voice[:, None] * x[members]).sum(0) / total
    spread = (voice[:, None] * z).T @ z
    # Coincident features on a line or plane leave no spacing: stay clear of rounding.
    spread += max(spacing, _FLATTEST * np.trace(spread)) * np.eye(dim)
    spread /= total + dim
    bandwidth = spread * max(total, 1.0) ** (-2 / (dim + 4))
    whiten = np.linalg.inv(np.linalg.cholesky(bandwidth))
    some = _thinned(np.arange(len(members)), _MEMBERS)
    members, voice = members[some], voice[some] * (total / voice[some].sum())
    kernels = _kernels(x[asked] @ whiten.T, x[members] @ whiten.T, asked, members, voice)
    return np.asarray(np.log(kernels + 1e-300) + np.log(np.diag(whiten)).sum())


def _thinned(indices: Ints, count: int) -> Ints:
    """About so many of the indices, evenly drawn."""
    return indices[:: -(-len(indices) // count)]


@compiled()
def _nearest(x: Floats, asked: Ints) -> Floats:
    """Squared distance of each x[asked] to the nearest other of x [n, dim]."""
    found = np.full(len(asked), np.inf)
    for k in range(len(asked)):
        i = asked[k]
        for j in range(len(x)):
            squared = 0.0
            for c in range(x.shape[1]):
                squared += (x[i, c] - x[j, c]) ** 2
            if j != i and squared < found[k]:
                found[k] = squared
    return found


@compiled()
def _kernels(x: Floats, b: Floats, asked: Ints, members: Ints, voice: Floats) -> Floats:
    """Sum of the members' kernels at each x [n, dim] but its own."""
    found = np.zeros(len(x))
    for i in range(len(x)):
        for j in range(len(b)):
            squared = 0.0
            for c in range(x.shape[1]):
                squared += (x[i, c] - b[j, c]) ** 2
            if asked[i] != members[j] and squared < _NOTHING:
                found[i] += voice[j] * np.exp(-0.5 * squared)
    return found
