"""Chooses key frames of the window and the trajectories that are compared by their motion between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Floats32, Ints, Slots
from ..trajectories.window import Window
from .noise import gross_errors, noise_variance

# Key frames, and how many of them a trajectory must be seen in to be compared; most trajectories that are.
_KEY_FRAMES, _LEAST_SEEN, _MOST_TRACKS = 24, 4, 1200
# Most ended trajectories that are compared, as a share of the current ones; and the number of compared ones
# up to which that sets no limit.
_ENDED_SHARE, _FEW_TRACKS = 0.5, 400
STEPS = (1, 4, 12)
"""Key frames; lengths of the frame pairs in which motion is measured."""


@dataclass(frozen=True)
class KeyFrames:
    """N trajectories on F instants, oldest first.

    Attributes
    ----------
    positions
        float32 [F, N, 2], px; 0 where unseen.
    visible
        bool [F, N].
    variance
        float32 [N], px²; noise of a coordinate.
    """

    positions: Floats32
    visible: Bools
    variance: Floats32

    def of(self, tracks: Ints) -> "KeyFrames":
        """The same instants for some of the trajectories, by index."""
        return KeyFrames(self.positions.take(tracks, 1), self.visible.take(tracks, 1), self.variance[tracks])


def evenly_spaced(count: int, most: int) -> Ints:
    """Up to `most` indices below `count`, evenly spread, both ends included."""
    steps = max(min(count, most) - 1, 1)
    return np.asarray((np.arange(min(count, most)) * (count - 1) + steps // 2) // steps)


def key_frames(window: Window, slots: Slots, variance: Floats, stamps: Sequence[int]) -> KeyFrames:
    """Trajectories (slots intp [N]) on key frames, of some instants (ns, ascending), less gross errors.

    `variance` float64 [N], px², is the noise of a coordinate.
    """
    states = window.states_at(slots, np.array(stamps, np.int64)[evenly_spaced(len(stamps), _KEY_FRAMES)])
    visible = states.held & ~gross_errors(states.position, states.held, variance)
    positions = np.where(visible[..., None], states.position, 0.0).astype(np.float32)
    return KeyFrames(positions, visible, variance.astype(np.float32))


def compared_trajectories(window: Window, current: Slots) -> tuple[Slots, KeyFrames]:
    """Choose key frames and the trajectories that are compared on them.

    Ended trajectories of the window are compared too: they connect those that came after them. Current ones
    go first, then those seen longest. The number of ended ones is limited by that of the current ones, and so
    is the time of an update.

    Parameters
    ----------
    window
        Store of all trajectories.
    current
        Slots intp [n] of the current ones.

    Returns
    -------
    Slots intp [N], by age of the trajectories, and their key frames.
    """
    slots, stamps = window.slots(), window.instants
    frames = key_frames(window, slots, noise_variance(window, slots, stamps), stamps)
    seen, ended = frames.visible.sum(axis=0), ~np.isin(slots, current)
    ready = np.flatnonzero(seen >= _LEAST_SEEN)
    many = round((1 + _ENDED_SHARE) * np.count_nonzero(~ended[ready]))
    rank = np.lexsort((-seen[ready], ended[ready]))
    chosen = np.sort(ready[rank[: min(_MOST_TRACKS, max(_FEW_TRACKS, many))]])
    return slots[chosen], frames.of(chosen)


def frame_pairs(count: int, steps: tuple[int, ...], most: int) -> Ints:
    """Pairs of `count` key frames (t, t + s), up to `most` for each step s, evenly spread, intp [Q, 2]."""
    starts = [evenly_spaced(max(count - step, 0), most) for step in steps]
    return np.concatenate([start[:, None] + [0, step] for start, step in zip(starts, steps, strict=True)])
