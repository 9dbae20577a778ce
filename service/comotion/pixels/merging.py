"""Merging of pieces, which decides the number of objects (METHOD-pixels step 6)."""

import numpy as np
from numpy.typing import NDArray

from ..config import PixelsConfig
from .continuity import Continuity
from .epipolar import EpipolarTest
from .pieces import Pieces


def merge(
    pieces: Pieces,
    continuity: Continuity,
    test: EpipolarTest,
    parameters: PixelsConfig,
    before: NDArray[np.int64] | None = None,
) -> NDArray[np.intp]:
    """Group of every piece, intp [P], as the index of a piece in it.

    The most similar pair comes first. Two groups merge if motion goes on across their border and
    they share an epipolar geometry, the one making up for the other. What the trajectories belonged
    to `before` (int64 [N], negative for nothing) counts too: what was seen apart is not joined at
    the first doubt, nor is what was together taken apart. What is too small then dissolves.
    """
    state = _Merging(pieces, continuity, test, parameters, before)
    while (pair := state.best_pair()) is not None:
        state.join(*pair)
    state.dissolve()
    return state.group


class _Merging:
    def __init__(
        self,
        pieces: Pieces,
        continuity: Continuity,
        test: EpipolarTest,
        parameters: PixelsConfig,
        before: NDArray[np.int64] | None,
    ) -> None:
        self._p = parameters
        self._continuity = continuity
        self._test = test
        self._members = pieces.members()
        self._weighted = pieces.weighted.copy()
        self._evidence = pieces.evidence.copy()
        self._size = np.array([len(m) for m in self._members], np.float64)
        self._open = np.ones(len(self._size), np.bool_)
        self._before = before
        self._merges: dict[tuple[int, int], bool] = {}
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
        self._merges = {pair: m for pair, m in self._merges.items() if a not in pair and b not in pair}

    def best_pair(self) -> tuple[int, int] | None:
        """The most similar pair that merges, by the similarity that its size asks for; None if none does."""
        p = self._p
        smaller = np.minimum(np.minimum(self._size[:, None], self._size[None]), p.merge_cap)
        ratio = np.triu(self._similarity(), 1) / (p.merge_similarity * np.sqrt(smaller / p.merge_size))
        pairs = np.flatnonzero(ratio >= p.merge_range[0])
        for flat in pairs[np.argsort(-ratio.flat[pairs], kind="stable")].tolist():
            a, b = divmod(flat, len(ratio))
            if self._merge(a, b, float(ratio[a, b])):
                return a, b
        return None

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

    def _merge(self, a: int, b: int, ratio: float) -> bool:
        if ratio >= self._p.merge_range[1]:
            return True
        if min(self._size[a], self._size[b]) < self._smallest:
            return ratio >= 1
        if (a, b) not in self._merges:
            self._merges[a, b] = self._one_body(a, b, ratio)
        return self._merges[a, b]

    def _one_body(self, a: int, b: int, ratio: float) -> bool:
        """Whether what speaks for one body outweighs what speaks against."""
        p = self._p
        held = self._held(a, b)
        border = self._continuity.border(self._members[a], self._members[b])
        if border is None:
            return bool(np.log(ratio) + held >= 0)
        evidence = border.drop + p.border_distance * np.log1p(border.distance) - p.border_least
        evidence += p.ratio_weight * np.clip(np.log(ratio), -2, 2) + held
        least, most = p.epipolar_limits
        if evidence < p.epipolar_weight * least:
            return False
        seen = self._test.compare(self._members[a], self._members[b])
        if seen is None:
            return bool(evidence >= p.epipolar_weight * p.epipolar_unknown)
        if seen.one_rests:
            return False
        return bool(evidence >= p.epipolar_weight * np.clip(seen.log_ratio, least, most))

    def _held(self, a: int, b: int) -> float:
        """What having been one hypothesis, or two, counts."""
        mine, other = (self._was(self._members[group]) for group in (a, b))
        if mine is None or other is None:
            return 0.0
        return self._p.held_together if mine == other else -self._p.held_apart

    def _was(self, members: NDArray[np.intp]) -> int | None:
        """What most of the members belonged to."""
        if self._before is None:
            return None
        known, counts = np.unique(self._before[members], return_counts=True)
        best = int(known[counts.argmax()])
        return best if best >= 0 else None
