"""Groups of updates in; which hypotheses are known to be bodies of their own, also at rest, out.

A body that rests cannot be told from what it rests on once its motion has left the window, or the features
that showed it are lost. So this keeps whether a hypothesis has once moved as a group of its own, and whether
its features have since moved together with another group for seconds.
"""

from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels
from .key_frames import KeyFrames

# s of motion as a group of its own, until a hypothesis is known to be separate; and s of motion together with
# another group, until it no longer is.
_SEPARATE_AFTER, _FORGET_AFTER = 1.0, 2.0
# px; a trajectory whose positions in the window lie farther apart has moved.
_MOVED_PX = 3.0


class Separation:
    """Hypotheses that have moved on their own, and for how long, in s of event time.

    Parameters
    ----------
    smallest
        Members that a group has at least.
    """

    def __init__(self, smallest: int) -> None:
        self._smallest = smallest
        self._seconds: dict[int, float] = {}
        self._contrary: dict[int, float] = {}
        self._stamp_ns: int | None = None

    def keep(self, frames: KeyFrames, labels: Ints, before: Labels, stamp_ns: int) -> Ints:
        """Labels after separate hypotheses that were joined with another group have got their own again.

        Parameters
        ----------
        frames
            N trajectories.
        labels
            intp [N], 0 to K - 1, as the motion in the window tells.
        before
            int64 [N], hypotheses of the previous update, negative for none.
        stamp_ns
            Event time.
        """
        step = 0.0 if self._stamp_ns is None else max((stamp_ns - self._stamp_ns) * 1e-9, 0.0)
        self._stamp_ns = stamp_ns
        moved = extents(frames) > _MOVED_PX
        present = np.unique(before[before >= 0])
        owner = _owners(labels, before)
        self._forget_absent(present)
        kept = labels.copy()
        for one in present.tolist():
            members = before == one
            if one in owner:
                self._contrary.pop(one, None)
                if len(owner) > 1 and _mostly(moved[members]):
                    self._seconds[one] = self._seconds.get(one, 0.0) + step
            elif self._seconds.get(one, 0.0) >= _SEPARATE_AFTER:
                joined = members & (labels == np.bincount(labels[members]).argmax())
                self._contrary[one] = self._contrary.get(one, 0.0) + step if _mostly(moved[joined]) else 0.0
                if self._contrary[one] > _FORGET_AFTER:
                    self._seconds.pop(one)
                elif joined.sum() >= self._smallest:
                    kept[joined] = kept.max() + 1
        return kept

    def _forget_absent(self, present: Labels) -> None:
        kept = set(present.tolist())
        self._seconds = {one: s for one, s in self._seconds.items() if one in kept}
        self._contrary = {one: s for one, s in self._contrary.items() if one in kept}

    def state(self) -> list[list[Any]]:
        """As plain values."""
        return [[one, seconds] for one, seconds in self._seconds.items()]

    def load(self, state: list[list[Any]]) -> None:
        """Take up :meth:`state`."""
        self._seconds = {int(one): float(seconds) for one, seconds in state}


def extents(frames: KeyFrames) -> Floats:
    """Diagonal of the box that holds the positions of each trajectory, float64 [N] px."""
    visible = frames.visible[..., None]
    low = np.where(visible, frames.positions, np.inf).min(axis=0)
    high = np.where(visible, frames.positions, -np.inf).max(axis=0)
    size = np.where(np.isfinite(low) & np.isfinite(high), high - low, 0.0).astype(np.float64)
    return np.asarray(np.hypot(size[:, 0], size[:, 1]))


def _owners(labels: Ints, before: Labels) -> set[int]:
    """Hypotheses that most members of some group had."""
    found = set()
    for group in range(int(labels.max(initial=-1)) + 1):
        known, counts = np.unique(before[(labels == group) & (before >= 0)], return_counts=True)
        if len(known):
            found.add(int(known[counts.argmax()]))
    return found


def _mostly(flags: Bools) -> bool:
    return len(flags) > 0 and 2 * int(flags.sum()) > len(flags)
