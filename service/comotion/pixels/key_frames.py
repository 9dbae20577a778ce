"""Chooses key frames of the window and the trajectories that are compared by their motion between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Floats32, Ints, Slots, Stamps
from ..config import PixelsConfig
from ..trajectories.window import Window
from .noise import gross_errors, noise_variance

# Key frames that a trajectory must be seen in to be compared.
_LEAST_SEEN = 4
# Most ended trajectories that are compared, as a share of the current ones; and the number of compared ones
# up to which that sets no limit.
_ENDED_SHARE, _FEW_TRACKS = 0.5, 400
# Key frames; lengths of the frame pairs in which motion is measured.
STEPS = (1, 4, 12)


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
        return KeyFrames(
            np.ascontiguousarray(self.positions[:, tracks]),
            np.ascontiguousarray(self.visible[:, tracks]),
            self.variance[tracks],
        )


def evenly_spaced(count: int, most: int) -> Ints:
    """Up to `most` indices below `count`, evenly spread, both ends included."""
    if count <= most:
        return np.arange(count)
    return np.round(np.linspace(0, count - 1, most)).astype(np.intp)


def compared_trajectories(
    window: Window, current: Slots, stamps: Sequence[int], p: PixelsConfig
) -> tuple[Slots, KeyFrames]:
    """Choose key frames and the trajectories that are compared on them.

    Ended trajectories of the window are compared too: they connect those that came after them.

    Parameters
    ----------
    window
        Store of all trajectories.
    current
        Slots intp [n] of the current ones.
    stamps
        ns, ascending; instants at which something was observed.

    Returns
    -------
    Slots intp [N], by age of the trajectories, and their key frames.
    """
    instants = np.array(stamps, np.int64)
    slots = window.slots()
    chosen = instants[evenly_spaced(len(instants), p.key_frames)]
    frames = _key_frames(window, slots, chosen, noise_variance(window, slots, stamps))
    chosen = choose(frames.visible.sum(axis=0), ~np.isin(slots, current), p.most_tracks)
    return slots[chosen], frames.of(chosen)


def frames_since(window: Window, slots: Slots, first_ns: int, last_ns: int, most: int) -> KeyFrames:
    """Up to `most` key frames of trajectories (slots intp [N]) after a time, up to another, ns."""
    stamps = [stamp for stamp in window.instants if first_ns < stamp <= last_ns]
    chosen = np.array(stamps, np.int64)[evenly_spaced(len(stamps), most)]
    return _key_frames(window, slots, chosen, noise_variance(window, slots, stamps))


def choose(seen: Ints, ended: Bools, limit: int) -> Ints:
    """Indices of the trajectories that are compared, intp, ascending.

    Current ones go first, then those seen longest. The number of ended ones is limited by that of the
    current ones, and so is the time of an update.

    Parameters
    ----------
    seen
        intp [N]; on how many key frames.
    ended
        bool [N]; not among the current ones.
    limit
        Most that are compared.
    """
    ready = np.flatnonzero(seen >= _LEAST_SEEN)
    current = len(ready) - int(ended[ready].sum())
    most = min(limit, max(_FEW_TRACKS, round((1 + _ENDED_SHARE) * current)))
    rank = np.lexsort((-seen[ready], ended[ready]))
    return np.sort(ready[rank[:most]])


def _key_frames(window: Window, slots: Slots, stamps: Stamps, variance: Floats) -> KeyFrames:
    """States of trajectories (slots intp [N]), of a noise float64 [N] px², at instants int64 [F] ns.

    Features of one camera share its frames, so that only observed states count. With several
    sources in a space there is no common frame: states between two observations count too.
    """
    several = len(np.unique(window.source[slots])) > 1
    states = window.states_at(slots, stamps)
    visible = states.held if several else states.observed
    visible = visible & ~gross_errors(states.position, visible, variance)
    positions = np.where(visible[..., None], states.position, 0.0).astype(np.float32)
    return KeyFrames(positions, visible, variance.astype(np.float32))


def frame_pairs(frames: KeyFrames) -> tuple[Floats32, Floats32, Floats32]:
    """Where N trajectories start and how far they move over Q pairs of key frames (t, t + s), s in `STEPS`.

    Returns
    -------
    Starts and displacements float32 [Q, 2, N], px, and seen float32 [Q, N]: 1 where a trajectory is seen in
    both frames; else all are 0.
    """
    count = len(frames.positions)
    first = np.concatenate([np.arange(max(count - s, 0)) for s in STEPS])
    second = np.concatenate([np.arange(min(s, count), count) for s in STEPS])
    seen = (frames.visible[first] & frames.visible[second]).astype(np.float32)
    start = frames.positions[first]
    masked = np.stack([start, frames.positions[second] - start]) * seen[..., None]
    start, displacement = np.ascontiguousarray(masked.transpose(0, 1, 3, 2))
    return start, displacement, seen
