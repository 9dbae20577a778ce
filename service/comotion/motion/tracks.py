"""What the method reads of a window: every trajectory with an observation in it, as columns."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..window import Bools, Floats, Slots, Stamps, Window

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Tracks:
    """N trajectories, dead ones included, and their M observations up to the watermark.

    Attributes
    ----------
    dim
        2 or 3.
    times, positions, sigma, quaternions
        int64 [M] ns, float64 [M, dim], [M] (NaN: unknown), [M, 4] (NaN: a point) or None.
    offsets
        intp [N + 1]; observations of trajectory i are [offsets[i]:offsets[i + 1]].
    key, source, alive
        int64 [N] stable number, intp [N] session index, bool [N] current at the watermark.
    period
        float64 [N], s, median spacing of the observations of its source.
    """

    dim: int
    times: Stamps
    positions: Floats
    sigma: Floats
    quaternions: Floats | None
    offsets: Ints
    key: Stamps
    source: Slots
    alive: Bools
    period: Floats

    @property
    def start(self) -> Ints:
        """First observation of each trajectory, intp [N]."""
        return self.offsets[:-1]

    @property
    def stop(self) -> Ints:
        """One past the last observation, intp [N]."""
        return self.offsets[1:]

    def newest(self) -> Floats:
        """Newest position of each trajectory, float64 [N, 3], zero in the third column in 2-D."""
        found = np.zeros((len(self.key), 3))
        found[:, : self.dim] = self.positions[self.stop - 1]
        return found

    def extent(self) -> float:
        """Root mean square distance of the living from their median, the scale of the scene."""
        last = self.newest()
        last = last[self.alive] if self.alive.any() else last
        spread = float(np.sqrt(((last - np.median(last, 0)) ** 2).sum(1).mean()))
        # One trajectory alone has no spread; the size of its coordinates is all the scale there is.
        return spread if spread > 0 else float(np.abs(last).max(initial=0.0)) + 1e-9


def gather(window: Window, current: Slots, stamp_ns: int) -> Tracks:
    """Columns of every trajectory that has an observation in the window up to `stamp_ns`."""
    slots = window.slots()
    slots = slots[window.counts(slots) > 0]
    inside = np.arange(window.times.shape[1])
    mask = (inside >= window.start[slots, None]) & (inside < window.stop[slots, None])
    mask &= window.times[slots] <= stamp_ns
    counts = mask.sum(1)
    slots, mask, counts = slots[counts > 0], mask[counts > 0], counts[counts > 0]
    times = window.times[slots][mask]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    turns = None if window.quaternions is None else window.quaternions[slots][mask]
    return Tracks(
        dim=window.dim,
        times=times,
        positions=window.positions[slots][mask],
        sigma=window.sigma[slots][mask],
        quaternions=turns if turns is not None and np.isfinite(turns).any() else None,
        offsets=offsets,
        key=window.key[slots].copy(),
        source=window.source[slots].copy(),
        alive=np.isin(slots, current),
        period=_periods(times, offsets, window.source[slots]),
    )


def _periods(times: Stamps, offsets: Ints, source: Slots) -> Floats:
    """Median spacing of each trajectory's source, s; 0 where nothing was observed twice."""
    steps = np.diff(times) * 1e-9
    owner = np.repeat(source, np.diff(offsets))
    within = np.ones(len(steps), np.bool_)
    within[offsets[1:-1] - 1] = False
    found = np.zeros(len(source))
    for one in np.unique(source).tolist():
        mine = steps[within & (owner[:-1] == one)]
        found[source == one] = np.median(mine) if len(mine) else 0.0
    return found


def restamped(tracks: Tracks, times: Stamps, positions: Floats, quaternions: Floats | None) -> Tracks:
    """The same trajectories with corrected observations."""
    return replace(tracks, times=times, positions=positions, quaternions=quaternions)
