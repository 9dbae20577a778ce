"""Says in words what is probably wrong with trajectories, where it is too uncertain for an error."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .types import Unit

# What sensors of features see spans less; people give millimetres more often than a city, m.
_WIDEST_M = 200.0
# px; what is normalised by the size of the image, or by its focal length, spans less.
_NARROWEST_PX = 4.0
# Rows that are looked at.
_MOST_INSTANTS, _MOST_FEATURES = 4000, 256
_LEAST_FEATURES = 5
# Share of the features that jump at once, and share of a jump by which the end misses where another was.
_JUMPING, _MISS = 0.3, 0.25
_LEAST_TRADES = 2
# Steps of single precision that the extent of what is seen should have at least.
_LEAST_STEPS = 1000
# Share of the positions that stand for something unseen, and how often one repeats then.
_MADE_UP, _LEAST_RUN = 0.01, 5


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
    One sentence each: millimetres for metres, places far from the origin or made up, ids that change hands.
    """
    sampled = positions[:, np.unique(np.linspace(0, positions.shape[1] - 1, _MOST_FEATURES).astype(np.intp))]
    instants = np.unique(np.linspace(0, len(positions) - 1, _MOST_INSTANTS).astype(np.intp))
    seen = sampled[instants]
    seen = seen[np.isfinite(seen[..., 0])]
    if scaled := other_unit(seen, unit):
        yield scaled
    if far := coarse(seen):
        yield far
    trades = [k for k in instants[:-1].tolist() if trading(sampled[k], sampled[k + 1]) > _JUMPING]
    if len(trades) >= _LEAST_TRADES:
        yield (
            f"at {len(trades)} of {len(instants) - 1} steps, first after instant {trades[0]}, features jump "
            "to where others were: an id must stay with its feature, and is no index of a list"
        )
    else:
        yield from _made_up(sampled)


def other_unit(positions: NDArray[np.floating], unit: Unit) -> str | None:
    """Say that positions [n, dim] span more than metres, or less than pixels, usually do."""
    if len(positions) < _LEAST_FEATURES:
        return None
    spread = 2 * float(np.quantile(np.linalg.norm(positions - np.median(positions, axis=0), axis=1), 0.9))
    if unit == "m" and spread > _WIDEST_M:
        return (
            f"positions span {spread:.4g} m; if they are millimetres, divide them by 1000: all lengths and "
            "velocities found are in the unit given"
        )
    if unit == "px" and spread < _NARROWEST_PX:
        return f"positions span {spread:.4g} px; if they are shares of the image, multiply them by its size"
    return None


def too_seldom(step_s: float, timeout_s: float, unit: Unit) -> str | None:
    """Say that features in pixels end between two instants, `step_s` apart: nothing is found then."""
    if unit != "px" or step_s <= timeout_s:
        return None
    return (
        f"one instant in {step_s:.3g} s is too seldom to see motion in an image: features end after "
        f"track_timeout, {timeout_s:g} s; give {1 / timeout_s:.3g} or more a second"
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


def _made_up(positions: NDArray[np.float64]) -> Iterator[str]:
    """Say that places [T, N, dim] stand for what was not seen: zeros, or the last one again and again."""
    zero, seen = (positions == 0).all(axis=2), np.isfinite(positions[..., 0])
    sometimes = zero & (seen & ~zero).any(axis=0)
    count = max(int(seen.sum()), 1)
    share = float(sometimes.sum()) / count
    if share > _MADE_UP:
        yield (
            f"{share:.0%} of the positions are exactly zero, of features that are elsewhere too: give NaN "
            "for unseen"
        )
    same = (positions[1:] == positions[:-1]).all(axis=2)
    # Where most steps are none, a coarse sensor says so of what rests.
    same &= same.sum(axis=0) < seen.sum(axis=0) / 2
    run = _LEAST_RUN - 1
    if len(same) >= run:
        frozen = np.lib.stride_tricks.sliding_window_view(same & ~zero[1:], run, axis=0).all(axis=2)
        share = float(frozen.sum()) / count
        if share > _MADE_UP:
            yield (
                f"{share:.0%} of the positions repeat the last ones exactly, {_LEAST_RUN} times or more in a "
                "row: give NaN for unseen, not where it was seen last"
            )


def trading(earlier: NDArray[np.floating], later: NDArray[np.floating]) -> float:
    """Share of the features that are seen twice, and the second time where another was the first time.

    They have moved, against the others, by more than half of all are from the middle.

    Parameters
    ----------
    earlier, later
        float [N, dim] of the same features, rows of NaN where unseen.
    """
    both = np.isfinite(earlier[:, 0]) & np.isfinite(later[:, 0])
    if np.count_nonzero(both) < _LEAST_FEATURES:
        return 0.0
    old, new = earlier[both].astype(np.float64), later[both].astype(np.float64)
    step = new - old
    size = np.linalg.norm(step - _middle(step), axis=1)
    spread = float(_middle(np.linalg.norm(new - _middle(new), axis=1)))
    jumped = np.flatnonzero(size > max(spread, 1e-9))
    if len(jumped) < _JUMPING * len(old):
        return 0.0
    miss = np.linalg.norm(new[jumped, None] - old[None], axis=2).min(axis=1)
    return float(np.count_nonzero(miss < _MISS * size[jumped])) / len(old)


def _middle(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper median along the first axis, for a tenth of the time that NumPy's median takes."""
    return np.asarray(np.partition(values, len(values) // 2, axis=0)[len(values) // 2])
