"""Merging of pieces, which decides the number of objects (METHOD-pixels step 6)."""

import numpy as np
from numpy.typing import NDArray

from .epipolar import EpipolarTest
from .parameters import PixelParameters
from .pieces import Pieces


def merge(
    pieces: Pieces, test: EpipolarTest, parameters: PixelParameters, before: NDArray[np.int64] | None = None
) -> NDArray[np.intp]:
    """Group of every piece, intp [P], as the index of a piece in it.

    Two groups merge while their mean similarity reaches a threshold that grows with the size of the
    smaller one; near the threshold the epipolar test has a say, and so has what the trajectories
    belonged to `before` (int64 [N], negative for nothing): what has been seen apart is not joined
    at the first doubt. What is too small then dissolves.
    """
    state = _Merging(pieces, test, parameters, before)
    while (pair := state.best_pair()) is not None:
        state.join(*pair)
    state.dissolve()
    return state.group


class _Merging:
    def __init__(
        self,
        pieces: Pieces,
        test: EpipolarTest,
        parameters: PixelParameters,
        before: NDArray[np.int64] | None,
    ) -> None:
        self._p = parameters
        self._test = test
        self._members = pieces.members()
        self._weighted = pieces.weighted.copy()
        self._evidence = pieces.evidence.copy()
        self._size = np.array([len(m) for m in self._members], np.float64)
        self._open = np.ones(len(self._size), np.bool_)
        self._before = before
        self._factors: dict[tuple[int, int], float] = {}
        self.group = np.arange(len(self._size))
        self._smallest = max(parameters.smallest, parameters.smallest_share * self._size.sum())

    def join(self, first: int, second: int) -> None:
        """The smaller goes into the larger."""
        a, b = (first, second) if self._size[first] >= self._size[second] else (second, first)
        for sums in (self._weighted, self._evidence):
            sums[a] += sums[b]
            sums[:, a] += sums[:, b]
        self._size[a] += self._size[b]
        self._members[a] = np.concatenate([self._members[a], self._members[b]])
        self._open[b] = False
        self.group[self.group == b] = a
        self._factors = {pair: f for pair, f in self._factors.items() if a not in pair and b not in pair}

    def best_pair(self) -> tuple[int, int] | None:
        """The pair that reaches its threshold by most, if any does."""
        p, (_, most) = self._p, self._p.epipolar_limits
        smaller = np.minimum(np.minimum(self._size[:, None], self._size[None]), p.merge_cap)
        ratio = np.triu(self._similarity(), 1) / (p.merge_similarity * np.sqrt(smaller / p.merge_size))
        best, found = 1.0, None
        for flat in np.argsort(-ratio, axis=None, kind="stable").tolist():
            a, b = divmod(flat, len(ratio))
            plain = float(ratio[a, b])
            if plain >= p.epipolar_top and found is None:
                return a, b
            # The factor is costly: no pair is asked that could not win any more.
            if plain * most < best:
                break
            if (value := plain * self._factor(a, b)) >= best:
                best, found = value, (a, b)
        return found

    def dissolve(self) -> None:
        """Groups that are too small go where they fit best, the smallest first."""
        while self._open.sum() > 1:
            groups = np.flatnonzero(self._open)
            smallest = int(groups[np.argmin(self._size[groups])])
            if self._size[smallest] >= self._smallest:
                return
            self.join(int(np.argmax(self._similarity()[smallest])), smallest)

    def _similarity(self) -> NDArray[np.float64]:
        mean: NDArray[np.float64] = self._weighted / self._evidence
        mean[~self._open] = -1
        mean[:, ~self._open] = -1
        np.fill_diagonal(mean, -1)
        return mean

    def _factor(self, a: int, b: int) -> float:
        """What speaks for (> 1) or against a merge beside similarity."""
        if min(self._size[a], self._size[b]) < self._smallest:
            return 1.0
        if (a, b) not in self._factors:
            self._factors[a, b] = self._epipolar(a, b) * (self._p.apart if self._were_apart(a, b) else 1.0)
        return self._factors[a, b]

    def _epipolar(self, a: int, b: int) -> float:
        p = self._p
        log_ratio = self._test.log_ratio(self._members[a], self._members[b])
        if log_ratio is None:
            return 1.0
        return float(
            np.clip((p.epipolar_reference / np.exp(log_ratio)) ** p.epipolar_power, *p.epipolar_limits)
        )

    def _were_apart(self, a: int, b: int) -> bool:
        mine, other = (self._was(self._members[group]) for group in (a, b))
        return mine is not None and other is not None and mine != other

    def _was(self, members: NDArray[np.intp]) -> int | None:
        """What most of the members belonged to."""
        if self._before is None:
            return None
        known, counts = np.unique(self._before[members], return_counts=True)
        best = int(known[counts.argmax()])
        return best if best >= 0 else None
