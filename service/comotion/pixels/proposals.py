"""Proposes new bodies of trajectories that nothing explains, and pairs of bodies that move as one."""

from itertools import combinations

import numpy as np
from scipy.spatial.distance import cdist

from ..arrays import Bools, Floats, Ints
from .gains import group_gain
from .recent import Recent

LEAST_MEMBERS = 5
"""Members from which on a group is proposed as a body."""

# Seeds that are tried for each group; a seed and its nearest, to which its motion is fitted first.
_SEEDS, _PICKED = 12, 7
# px of distance in the image that a px of difference in displacement counts for.
_MOTION_WEIGHT = 10.0
# nat; mean gain from which on two groups move as one.
_AS_ONE = 0.3
# Comparisons with motion as one until two bodies are merged, and if one has not lasted; limit of the sum.
_MERGE_AFTER, _MERGE_YOUNG, _MOST_SUM = 4.0, 0.5, 7.0


def find_groups(recent: Recent, free: Bools) -> list[Ints]:
    """Groups of trajectories with a common motion, the largest first.

    Parameters
    ----------
    recent, free
        n trajectories, and among which of them, bool [n], groups are looked for.

    Returns
    -------
    list of intp [m]
        Of :data:`LEAST_MEMBERS` or more each.
    """
    groups, left = [], np.flatnonzero(free)
    while len(left) >= LEAST_MEMBERS:
        part, seeds = recent.of(left), np.unique(np.linspace(0, len(left) - 1, _SEEDS).astype(int)).tolist()
        alike = [_moving_as(part, seed) for seed in seeds]
        best = max((moving & (far < 2 * recent.reach) for moving, far in alike), key=np.count_nonzero)
        if best.sum() < LEAST_MEMBERS:
            # Bodies far apart rarely move as one: that must explain most of those it was not fitted to.
            best = max((moving for moving, _ in alike), key=np.count_nonzero)
            if 2 * best.sum() <= len(left) + _PICKED:
                break
        groups.append(left[best])
        left = left[~best]
    return groups


def _moving_as(recent: Recent, seed: int) -> tuple[Bools, Floats]:
    """Trajectories that move as a seed and its nearest do, bool [n], and how far they are from it, [n]."""
    step = recent.displacement[0]
    far = np.linalg.norm(recent.position - recent.position[seed], axis=1)
    far += _MOTION_WEIGHT * np.linalg.norm(step - step[seed], axis=1)
    nearest = np.zeros(len(far), np.bool_)
    nearest[np.argsort(far, kind="stable")[:_PICKED]] = True
    return group_gain(recent, nearest) > 0, far


def as_one(recent: Recent, rest: Floats, first: Ints, second: Ints) -> float:
    """How well one motion explains two groups of neighbours, above 0 if it does, at most 1; 0 if both rest.

    It is the mean gain of the group that is explained worse. `rest` float64 [n] are gains under rest lately,
    `first` and `second` intp rows.
    """
    if not len(first) or not len(second):
        return -1.0
    # What rests moves with nothing; an affine motion of both would be a shear.
    resting = [rest[rows].sum() > 0 for rows in (first, second)]
    if any(resting):
        return 0.0 if all(resting) else -1.0
    if cdist(recent.position[first], recent.position[second]).min() > recent.reach:
        return -1.0
    both = np.concatenate([first, second])
    joint = group_gain(recent.of(both), np.ones(len(both), np.bool_))
    worse = min(joint[: len(first)].mean(), joint[len(first) :].mean())
    return float((worse - _AS_ONE) / (1 - _AS_ONE))


class Together:
    """For how many comparisons pairs of bodies have moved as one; less for those that have not."""

    def __init__(self) -> None:
        self._sums: dict[tuple[int, int], float] = {}

    def compare(self, recent: Recent, rest: Floats, members: dict[int, Ints]) -> None:
        """Compare all pairs of bodies, by rows intp of the members of each; `rest` as in :func:`as_one`."""
        for pair in combinations(sorted(members), 2):
            total = self._sums.get(pair, 0.0) + as_one(recent, rest, *(members[body] for body in pair))
            self._sums[pair] = min(max(total, -_MOST_SUM), _MOST_SUM)

    def merged(self, lasted: set[int], *, both: bool) -> tuple[int, int] | None:
        """A pair that has moved as one for long enough: soon if one has not lasted; others only if `both`."""
        after = _MERGE_YOUNG, _MERGE_AFTER if both else np.inf
        sums = self._sums.items()
        return next((pair for pair, total in sums if total > after[lasted.issuperset(pair)]), None)

    def part(self, a: int, b: int) -> None:
        """Two bodies are not one."""
        self._sums[min(a, b), max(a, b)] = -_MOST_SUM

    def forget(self, body: int) -> None:
        """A body is no more."""
        self._sums = {pair: total for pair, total in self._sums.items() if body not in pair}
