"""Says in words what is probably wrong with trajectories, where it is too uncertain for an error."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .types import Unit

# What sensors of features see spans less; people give millimetres more often than a city, m.
_WIDEST_M = 200.0
# Rows that are looked at.
_MOST_INSTANTS, _MOST_FEATURES = 4000, 256
_LEAST_FEATURES = 5
# Share of the features that jump at once, and share of a jump by which the end misses where another was.
_JUMPING, _MISS = 0.3, 0.25
_LEAST_TRADES = 2
# Steps of single precision that the extent of what is seen should have at least.
_LEAST_STEPS = 1000


def doubts(positions: NDArray[np.float64], unit: Unit) -> Iterator[str]:
    """Say what is probably wrong with the trajectories of one source.

    Parameters
    ----------
    positions
        float64 [T, N, dim], rows of NaN where unseen.
    unit
        Theirs.

    Yields
    ------
    One sentence each: millimetres for metres, places far from the origin, or ids that change hands.
    """
    sampled = positions[:, np.unique(np.linspace(0, positions.shape[1] - 1, _MOST_FEATURES).astype(np.intp))]
    instants = np.unique(np.linspace(0, len(positions) - 1, _MOST_INSTANTS).astype(np.intp))
    seen = sampled[instants]
    seen = seen[np.isfinite(seen[..., 0])]
    spread = 2 * float(np.quantile(np.linalg.norm(seen - np.median(seen, axis=0), axis=1), 0.9))
    if unit == "m" and spread > _WIDEST_M:
        yield (
            f"positions span {spread:.4g} m; if they are millimetres, divide them by 1000: all lengths and "
            "velocities found are in the unit given"
        )
    if far := coarse(seen):
        yield far
    trades = [k for k in instants[:-1].tolist() if trading(sampled[k], sampled[k + 1]) > _JUMPING]
    if len(trades) >= _LEAST_TRADES:
        yield (
            f"at {len(trades)} of {len(instants) - 1} steps, first after instant {trades[0]}, features jump "
            "to where others were: an id must stay with its feature, and is no index of a list"
        )


def coarse(positions: NDArray[np.floating]) -> str | None:
    """Say that positions [n, dim] are so far from the origin that messages lose their motion, as in UTM."""
    if len(positions) < _LEAST_FEATURES:
        return None
    farthest = float(np.abs(positions).max())
    step, extent = float(np.spacing(np.float32(farthest))), float(np.ptp(positions, axis=0).max())
    if not 0 < extent < _LEAST_STEPS * step:
        return None
    return (
        f"positions are {farthest:.3g} from the origin, where the single precision of messages has steps of "
        f"{step:.1g}, for a scene of {extent:.3g}: subtract a fixed place amid the features from all"
    )


def trading(before: NDArray[np.floating], now: NDArray[np.floating]) -> float:
    """Share of the features that are seen twice, and the second time where another was the first time.

    They have moved, against the others, by more than half of all are from the middle.

    Parameters
    ----------
    before, now
        float [N, dim] of the same features, rows of NaN where unseen.
    """
    both = np.isfinite(before[:, 0]) & np.isfinite(now[:, 0])
    if np.count_nonzero(both) < _LEAST_FEATURES:
        return 0.0
    old, new = before[both].astype(np.float64), now[both].astype(np.float64)
    step = new - old
    size = np.linalg.norm(step - np.median(step, axis=0), axis=1)
    spread = float(np.median(np.linalg.norm(new - np.median(new, axis=0), axis=1)))
    jumped = np.flatnonzero(size > max(spread, 1e-9))
    if len(jumped) < _JUMPING * len(old):
        return 0.0
    miss = np.linalg.norm(new[jumped, None] - old[None], axis=2).min(axis=1)
    return float(np.count_nonzero(miss < _MISS * size[jumped])) / len(old)
