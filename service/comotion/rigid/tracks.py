"""What the method reads of a window: every trajectory with an observation in it, without a copy."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..compiled import compiled
from ..trajectories.window import Window

# The spacing of a source that has more trajectories than this is read off a few, the oldest.
_MANY, _FEW = 128, 16


@dataclass(frozen=True)
class Tracks:
    """N trajectories, dead ones included, and their observations up to the watermark.

    Observations of trajectory i are [start[i]:stop[i]] of columns that hold others too: the window's own.
    Where a source is corrected, its stamps are to be moved by `delay_ns` and its positions by `turn` and
    `shift`: x' = turn x + shift.

    Attributes
    ----------
    dim
        2 or 3.
    times, positions, sigma, quaternions
        int64 [M] ns, float64 [M, dim], [M] (NaN: unknown), [M, 4] (NaN: a point) or None.
    start, stop
        intp [N].
    slot, key, source, alive
        intp [N] of the window, int64 [N] stable number, ascending, intp [N] session index, bool [N]
        current at the watermark.
    period
        float64 [N], s, median spacing of the observations of its source.
    last
        float64 [N, 3], newest position, corrected; zero in the third column in 2-D.
    delay_ns, turn, shift
        int64 [N], float64 [N, 3, 3], float64 [N, 3].
    """

    dim: int
    times: Stamps
    positions: Floats
    sigma: Floats
    quaternions: Floats | None
    start: Ints
    stop: Ints
    slot: Slots
    key: Stamps
    source: Slots
    alive: Bools
    period: Floats
    last: Floats
    delay_ns: Stamps
    turn: Floats
    shift: Floats

    def newest(self) -> Floats:
        """Newest position of each trajectory, float64 [N, 3], zero in the third column in 2-D."""
        return self.last

    def extent(self) -> float:
        """Root mean square distance of the living from their median, the scale of the scene."""
        last = self.last[self.alive] if self.alive.any() else self.last
        spread = float(np.sqrt(((last - np.median(last, 0)) ** 2).sum(1).mean()))
        # One trajectory alone has no spread; the size of its coordinates is all the scale there is.
        return spread if spread > 0 else float(np.abs(last).max(initial=0.0)) + 1e-9

    @property
    def corrected(self) -> Bools:
        """Whose positions are to be moved, bool [N]."""
        return np.asarray((self.shift != 0).any(1) | (self.turn != np.eye(3)).any((1, 2)), np.bool_)

    def moved(self, delay_ns: Stamps, turn: Floats, shift: Floats) -> "Tracks":
        """The same trajectories with corrections, of which there were none before."""
        last = np.einsum("nij,nj->ni", turn, self.last) + shift
        return replace(self, delay_ns=delay_ns, turn=turn, shift=shift, last=last)


def gather(window: Window, current: Slots, stamp_ns: int) -> Tracks:
    """Every trajectory that has an observation in the window up to `stamp_ns`."""
    slots = window.slots()
    rows = window.times.shape[1]
    stop = _stop(window.times, slots, window.start, window.stop, stamp_ns)
    held = stop > window.start[slots]
    slots, stop = slots[held], stop[held]
    start, stop = slots * rows + window.start[slots], slots * rows + stop
    times = window.times.reshape(-1)
    positions = window.positions.reshape(-1, window.dim)
    source = window.source[slots]
    alive = np.zeros(window.capacity, np.bool_)
    alive[current] = True
    last = np.zeros((len(slots), 3))
    last[:, : window.dim] = positions[stop - 1]
    return Tracks(
        dim=window.dim,
        times=times,
        positions=positions,
        sigma=window.sigma.reshape(-1),
        quaternions=None if window.quaternions is None else window.quaternions.reshape(-1, 4),
        start=start,
        stop=stop,
        slot=slots,
        key=window.key[slots],
        source=source,
        alive=alive[slots],
        period=_periods(times, start, stop, source),
        last=last,
        delay_ns=np.zeros(len(slots), np.int64),
        turn=np.tile(np.eye(3), (len(slots), 1, 1)),
        shift=np.zeros((len(slots), 3)),
    )


@compiled()
def _stop(times: Stamps, slots: Slots, start: Slots, stop: Slots, stamp_ns: int) -> Ints:
    """One past the last observation up to a time, in the row of each slot."""
    found = np.zeros(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        k = stop[s]
        while k > start[s] and times[s, k - 1] > stamp_ns:
            k -= 1
        found[n] = k
    return found


def ranges(start: Ints, stop: Ints) -> Ints:
    """All of start[0]:stop[0], start[1]:stop[1] and so on."""
    counts = stop - start
    before = np.cumsum(counts) - counts
    return np.asarray(np.arange(int(counts.sum())) + np.repeat(start - before, counts), np.intp)


def _periods(times: Stamps, start: Ints, stop: Ints, source: Slots) -> Floats:
    """Median spacing of each trajectory's source, s; 0 where nothing was observed twice."""
    found = np.zeros(len(source))
    for one in np.unique(source).tolist():
        mine = np.flatnonzero(source == one)
        some = mine[:_FEW] if len(mine) > _MANY else mine
        observed = ranges(start[some], stop[some])
        steps = np.diff(times[observed])
        within = np.ones(len(steps), np.bool_)
        within[np.cumsum(stop[some] - start[some])[:-1] - 1] = False
        found[mine] = np.median(steps[within] * 1e-9) if within.any() else 0.0
    return found
