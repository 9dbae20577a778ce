"""A window with its sums, and the same trajectories as plain lists, driven together."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from comotion.thesis.kernels import COMPARABLE_SAMPLES, FIRST, PLANES, SAMPLES, SECOND, STRIP, WEIGHTS
from comotion.thesis.pair_sums import PairSums
from comotion.trajectories.window import Window

from . import thesis as literal

MS = 1_000_000
T0 = 1_700_000_000_000 * MS

Point = tuple[float, ...]


@dataclass
class SideBySide:
    """Feed it observations and move the window on; `check` compares."""

    dim: int
    v_move: float | None
    span: int = 1000 * MS
    gap: int = 500 * MS
    sigma_switch: float = 0.02
    window: Window = field(init=False)
    pairs: PairSums = field(init=False)
    slots: dict[int, int] = field(default_factory=dict)
    lists: dict[int, literal.Trajectory] = field(default_factory=dict)
    oldest: int = -(2**63)

    def __post_init__(self) -> None:
        self.window = Window(self.dim, self.span, self.gap)
        self.pairs = PairSums(self.v_move, self.sigma_switch)

    def observe(self, stamp: int, points: dict[int, Point]) -> None:
        """One instant: {track: position}; new tracks are opened."""
        points = {track: x for track, x in points.items() if self._can_take(track, stamp)}
        if not points:
            return
        for track, x in points.items():
            if track not in self.slots:
                self.slots[track] = int(self.window.open(1, 0)[0])
                self.lists[track] = literal.Trajectory()
            self.lists[track].history.setdefault(stamp, x)
        slots = self.slots_of(points)
        positions = np.array(list(points.values()), float)
        self.window.insert(slots, stamp, positions, np.full(len(slots), np.nan), None)

    def slots_of(self, tracks: object) -> np.ndarray:
        return np.array([self.slots[track] for track in tracks], np.intp)  # type: ignore[attr-defined]

    def _can_take(self, track: int, stamp: int) -> bool:
        """Not older than the window, nor than what is left of a trajectory whose past has gone."""
        if stamp < self.oldest:
            return False
        if track not in self.lists:
            return True
        known = self.lists[track]
        return len(known.times()) == len(known.history) or stamp > known.times()[0]

    def evict(self, oldest: int) -> None:
        """Drop what is older; forget what is left too short and is not observed any more."""
        self.oldest = max(oldest, self.oldest)
        slots, counts = self.window.evictable(self.oldest)
        if len(slots):
            self.pairs.evicting(self.window, slots, counts)
            self.window.evict(slots, counts)
        for track, known in list(self.lists.items()):
            known.oldest = self.oldest
            if len(known.times()) < 2 and max(known.history) < self.oldest + self.span - self.gap:
                self.forget(track)

    def forget(self, track: int) -> None:
        del self.lists[track]
        slot = np.array([self.slots.pop(track)])
        self.pairs.forget(slot)
        self.window.close(slot)

    def samples(self, i: int, j: int) -> int:
        """Common samples of two tracks."""
        return int(self.variance([i, j])[1][0, 1])

    def variance(self, tracks: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(3.3) and the number of samples of each pair, read from the sums once they are up to date."""
        slots = self.slots_of(tracks)
        self.pairs.affinity(self.window, slots)
        rows = self.pairs.rows.of[slots]
        high, low = np.maximum.outer(rows, rows), np.minimum.outer(rows, rows)
        a, b = np.nonzero(low >= 0)
        (strip, row), (column, inside) = np.divmod(high[a, b], STRIP), np.divmod(low[a, b], STRIP)
        sums = np.zeros((*low.shape, PLANES))
        sums[a, b] = self.pairs.sums[strip * (strip + 1) // 2 + column, :, row, inside]
        weight, first, second = (sums[..., k] for k in (WEIGHTS, FIRST, SECOND))
        samples = sums[..., SAMPLES].astype(np.int64)
        weight = np.where(samples >= COMPARABLE_SAMPLES, weight, np.inf)
        return np.maximum(second - first**2 / weight, 0.0) / weight, samples

    def check(self) -> None:
        """Assert that samples are the same ones in number, and variances equal to 1e-6."""
        tracks = sorted(self.slots)
        variance, samples = self.variance(tracks)
        np.testing.assert_array_equal(variance, variance.T)
        for a, i in enumerate(tracks):
            for b, j in enumerate(tracks[:a]):
                pair = self.lists[i], self.lists[j]
                expected = literal.variance(*pair, self.gap, self.v_move)
                taking_part = min(len(t.times()) for t in pair) >= 2
                count = len(literal.samples(*pair, self.gap)) if taking_part else 0
                assert samples[a, b] == count, (i, j)
                if expected is None:
                    assert count < 2
                    continue
                assert variance[a, b] == pytest.approx(expected, rel=1e-6, abs=1e-12), (i, j)

    def check_affinities(self) -> None:
        """Assert that affinities are equal to 1e-5."""
        tracks = sorted(self.slots)
        found = self.pairs.affinity(self.window, self.slots_of(tracks))
        for a, i in enumerate(tracks):
            for b, j in enumerate(tracks[:a]):
                pair = self.lists[i], self.lists[j]
                comparable = min(len(t.times()) for t in pair) >= 2
                of = self.gap, self.v_move, self.sigma_switch
                expected = literal.affinity(*pair, *of) if comparable else 0.5
                assert found[a, b] == found[b, a] == pytest.approx(expected, abs=1e-5), (i, j)
