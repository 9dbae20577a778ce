"""Reads the trajectories that have an observation in a window (step 1), without a copy."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps, find, identities, median
from ..geometry.frames import DRAWN
from ..trajectories.window import Window
from .kernels.records import Observations
from .kernels.resampling import BESIDE, stop_at

# Positions count for the scale of the scene up to this many times the median distance: fewer than millimetres
# in a metre.
_FAR = 300.0
# What is known of trajectories that are gone.
_KEPT = ("covariance", "key", "source", "period", "newest", "delay_ns", "turn", "shift")


@dataclass(frozen=True)
class Tracks:
    """N trajectories, ended ones included, and their observations up to the watermark.

    Observations of trajectory i are [start[i]:stop[i]] of the columns of the window, which hold others too.
    The correction of a source is not yet applied to `times` and `positions`: t' = t + delay_ns and
    x' = turn x + shift.

    Attributes
    ----------
    dim
        2 or 3.
    times, positions, sigma, quaternions
        int64 [M] ns, float64 [M, dim], [M] (NaN: unknown), [M, 4] (NaN: a point) or None.
    covariance
        float64 [N, 6], of the newest observation as its source says: xx, xy, xz, yy, yz, zz (NaN: unknown).
    start, stop
        intp [N].
    slot, key, source, current
        intp [N] slot in the window; int64 [N] stable number, ascending; intp [N] index of the session;
        bool [N] whether the trajectory goes on at the watermark.
    period
        float64 [N], s, median time between observations of its source; zero until :meth:`timed`.
    newest
        float64 [N, 3], newest position, corrected; zero in the third column in 2-D.
    delay_ns, turn, shift
        int64 [N], float64 [N, 3, 3], float64 [N, 3], correction of the source.
    """

    dim: int
    times: Stamps
    positions: Floats
    sigma: Floats
    quaternions: Floats | None
    covariance: Floats
    start: Ints
    stop: Ints
    slot: Slots
    key: Stamps
    source: Slots
    current: Bools
    period: Floats
    newest: Floats
    delay_ns: Stamps
    turn: Floats
    shift: Floats

    @property
    def observations(self) -> Observations:
        """The observations as arguments of kernels."""
        return Observations(self.times, self.positions, self.start, self.stop)

    @cached_property
    def extent(self) -> float:
        """Root mean square distance of the current trajectories from their median: the scale of the scene.

        Positions that are hundreds of times farther out than most, such as outliers, do not count.
        """
        newest = self.newest[self.current] if self.current.any() else self.newest
        squares = ((newest - np.median(newest, 0)) ** 2).sum(1)
        near = squares[squares <= _FAR**2 * np.median(squares)]
        spread = float(np.sqrt((near if near.any() else squares).mean()))
        # A single trajectory has no spread: the size of its coordinates is the only scale.
        return spread if spread > 0 else float(np.abs(newest).max(initial=0.0)) + 1e-9

    def since(self, window: Window, stamp_ns: int) -> "Tracks":
        """The same trajectories without the observations long before a time; a few before it are kept."""
        older = stop_at(window.times, self.slot, window.start, window.stop, stamp_ns)
        # As many as distinguish a gross error from motion there.
        start = np.maximum(self.start, self.slot * window.times.shape[1] + older - BESIDE - 1)
        return replace(self, start=np.minimum(start, self.stop))

    def timed(self) -> "Tracks":
        """The same trajectories with their periods."""
        return replace(self, period=_periods(self.times, self.start, self.stop, self.source))

    def joined(self, now: "Tracks") -> "Tracks":
        """These trajectories as they are now, also those that are gone, and then the new ones.

        Those that are gone have no observations. The others keep the correction of their source, which `now`
        does not have; the new ones are of the same sources.
        """
        count, index = len(self.key), find(now.key, self.key)
        new = np.flatnonzero(index < 0)
        # Where those of `now` are.
        placed = index.copy()
        placed[new] = np.arange(count, count + len(new))
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(now, name)[new]]) for name in _KEPT
        }
        for name in ("start", "stop", "slot", "current"):
            columns[name] = np.zeros(count + len(new), getattr(now, name).dtype)
        for name in ("start", "stop", "slot", "current", "covariance"):
            columns[name][placed] = getattr(now, name)
        # A new trajectory has the period and the correction of the oldest one of its source.
        donor = [int(np.argmax(self.source == source)) for source in now.source[new]]
        for name in ("period", "delay_ns", "turn", "shift"):
            columns[name][count:] = columns[name][donor]
        columns["newest"][placed] = (
            np.einsum("nij,nj->ni", columns["turn"].take(placed, 0), now.newest) + columns["shift"][placed]
        )
        return replace(now, **columns)


def read_tracks(window: Window, current: Slots, stamp_ns: int) -> Tracks:
    """Read every trajectory that has an observation in the window up to the watermark `stamp_ns`.

    `current` intp [n] are the slots of the trajectories that go on.
    """
    slots = window.slots()
    rows = window.times.shape[1]
    stop = stop_at(window.times, slots, window.start, window.stop, stamp_ns)
    held = stop > window.start[slots]
    slots, stop = slots[held], stop[held]
    start, stop = slots * rows + window.start[slots], slots * rows + stop
    times = window.times.reshape(-1)
    positions = window.positions.reshape(-1, window.dim)
    going_on = np.zeros(window.capacity, np.bool_)
    going_on[current] = True
    newest = np.zeros((len(slots), 3))
    newest[:, : window.dim] = positions.take(stop - 1, 0)
    return Tracks(
        dim=window.dim,
        times=times,
        positions=positions,
        sigma=window.sigma.reshape(-1),
        quaternions=None if window.quaternions is None else window.quaternions.reshape(-1, 4),
        covariance=window.covariance.take(slots, 0),
        start=start,
        stop=stop,
        slot=slots,
        key=window.key[slots],
        source=window.source[slots],
        current=going_on[slots],
        period=np.zeros(len(slots)),
        newest=newest,
        delay_ns=np.zeros(len(slots), np.int64),
        turn=identities(len(slots)),
        shift=np.zeros((len(slots), 3)),
    )


def _periods(times: Stamps, start: Ints, stop: Ints, sources: Slots) -> Floats:
    """Median time between observations of each trajectory's source, s; 0 where nothing was observed twice."""
    period = np.zeros(len(sources))
    for source in np.unique(sources).tolist():
        members = np.flatnonzero(sources == source)
        first, last = start[members[:DRAWN]], stop[members[:DRAWN]]
        observed = np.concatenate([times[i:k] for i, k in zip(first.tolist(), last.tolist(), strict=True)])
        steps = np.delete(np.diff(observed), np.cumsum(last - first)[:-1] - 1)
        period[members] = median(steps * 1e-9) if len(steps) else 0.0
    return period
