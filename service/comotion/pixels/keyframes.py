"""Key frames: a dense and small view of the window (METHOD-pixels step 1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Slots
from ..compiled import compiled
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class KeyFrames:
    """N trajectories on F instants, oldest first.

    Attributes
    ----------
    positions
        float32 [F, N, 2], px; 0 where unseen.
    visible
        bool [F, N].
    """

    positions: Floats32
    visible: NDArray[np.bool_]

    def of(self, tracks: NDArray[np.intp]) -> "KeyFrames":
        """The same instants for some of the trajectories."""
        return KeyFrames(
            np.ascontiguousarray(self.positions[:, tracks]), np.ascontiguousarray(self.visible[:, tracks])
        )


@dataclass(frozen=True)
class FramePairs:
    """Where N trajectories start and how far they move over Q pairs of frames.

    Attributes
    ----------
    start, move
        float32 [Q, 2, N], px; 0 where a trajectory is not seen in both frames.
    seen
        float32 [Q, N]; 1 where it is, else 0.
    """

    start: Floats32
    move: Floats32
    seen: Floats32


def spread(count: int, wanted: int) -> NDArray[np.intp]:
    """Up to `wanted` indices below `count`, evenly spread, both ends included."""
    if count <= wanted:
        return np.arange(count)
    return np.round(np.linspace(0, count - 1, wanted)).astype(np.intp)


def key_frames(window: Window, slots: Slots, stamps: NDArray[np.int64]) -> KeyFrames:
    """States of trajectories (slots intp [N]) at instants int64 [F] ns.

    Features of one camera share its frames, so that only observed states count. With several
    sources in a space there is no common frame: states between two observations count too.
    """
    several = len(np.unique(window.source[slots])) > 1
    states = states_at(window, slots, stamps)
    visible = states.held if several else states.observed
    return KeyFrames(np.where(visible[..., None], states.position, 0.0).astype(np.float32), visible)


def frame_pairs(frames: KeyFrames, steps: tuple[int, ...]) -> FramePairs:
    """All pairs (t, t + s) of key frames, s in `steps`."""
    count = len(frames.positions)
    first = np.concatenate([np.arange(max(count - s, 0)) for s in steps])
    second = np.concatenate([np.arange(min(s, count), count) for s in steps])
    return FramePairs(*_pair(frames.positions, frames.visible, first, second))


@compiled()
def _pair(
    positions: Floats32, visible: NDArray[np.bool_], first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[Floats32, Floats32, Floats32]:
    shape = len(first), 2, visible.shape[1]
    start, move = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    seen = np.zeros((len(first), visible.shape[1]), np.float32)
    for q in range(len(first)):
        a, b = first[q], second[q]
        for i in range(visible.shape[1]):
            if visible[a, i] and visible[b, i]:
                seen[q, i] = 1
                for c in range(2):
                    start[q, c, i] = positions[a, i, c]
                    move[q, c, i] = positions[b, i, c] - positions[a, i, c]
    return start, move, seen
