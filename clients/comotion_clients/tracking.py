"""HOTA, IDF1 and switches of identity of hypotheses as tracked objects, as trackers are compared. Pure.

An object is matched with a hypothesis by the features that both have, divided by those that one of them
has: what the overlap of boxes or masks is for images. The figures are those of TrackEval, as
tests/unit/test_metrics.py holds. It is no dependency: it would install opencv-python over
opencv-python-headless. motmetrics had its last release in 2022.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from comotion_schemas import UNDETERMINED

_OVERLAPS = np.arange(0.05, 0.99, 0.05)
_THRESHOLD = 0.5
_EPSILON = float(np.finfo(float).eps)
# More than any overlap: who was matched at the last instant stays matched.
_STAYS = 1000.0


@dataclass(frozen=True)
class TrackingFigures:
    """HOTA with its parts of detection and association, IDF1, and the number of switches of identity."""

    hota: float
    det_a: float
    ass_a: float
    idf1: float
    id_switches: float


@dataclass(frozen=True)
class _Instant:
    """Numbers of objects [G] and hypotheses [K] at an instant, and their overlap [G, K]."""

    objects: NDArray[np.intp]
    hypotheses: NDArray[np.intp]
    overlap: NDArray[np.float64]


class Tracking:
    """Collects instants."""

    def __init__(self) -> None:
        self._instants: list[_Instant] = []
        self._objects: dict[int, int] = {}
        self._hypotheses: dict[int, int] = {}

    def add(self, labels: NDArray[np.int64], objects: NDArray[np.int32]) -> None:
        """Add an instant.

        `labels` int64 [N] are the hypothesis of each feature, or UNDETERMINED; `objects` int32 [N] its true
        object, those with -1 are left out.
        """
        labels, objects = labels[objects >= 0], objects[objects >= 0]
        true, row = np.unique(objects, return_inverse=True)
        listed, column = np.unique(labels, return_inverse=True)
        shared = np.zeros((len(true), len(listed)))
        np.add.at(shared, (row, column), 1)
        overlap = shared / (shared.sum(1)[:, None] + shared.sum(0)[None, :] - shared)
        kept = listed != UNDETERMINED
        numbers = _numbered(true, self._objects), _numbered(listed[kept], self._hypotheses)
        self._instants.append(_Instant(*numbers, overlap[:, kept]))

    def figures(self) -> TrackingFigures:
        """Figures over all instants; 0 where nothing is matched, NaN without any."""
        if not self._instants:
            return TrackingFigures(*[math.nan] * 5)
        objects = np.zeros(len(self._objects), np.intp)
        hypotheses = np.zeros(len(self._hypotheses), np.intp)
        for instant in self._instants:
            objects[instant.objects] += 1
            hypotheses[instant.hypotheses] += 1
        # In how many instants each object and each hypothesis is, summed, [G, K].
        counts = objects[:, None] + hypotheses[None, :]
        total = int(objects.sum() + hypotheses.sum())
        det_a, ass_a = _hota(self._instants, counts, total)
        return TrackingFigures(
            hota=float(np.sqrt(det_a * ass_a).mean()),
            det_a=float(det_a.mean()),
            ass_a=float(ass_a.mean()),
            idf1=_idf1(self._instants, counts, total),
            id_switches=_switches(self._instants, len(objects)),
        )


def _numbered(ids: NDArray[np.generic], numbers: dict[int, int]) -> NDArray[np.intp]:
    return np.array([numbers.setdefault(number, len(numbers)) for number in ids.tolist()], np.intp)


def _hota(
    instants: list[_Instant], counts: NDArray[np.intp], total: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Detection and association accuracy at each overlap (Luiten et al. 2021, eq. 4 to 9)."""
    alignment = np.zeros(counts.shape)
    for instant in instants:
        either = instant.overlap.sum(0)[None, :] + instant.overlap.sum(1)[:, None] - instant.overlap
        share = np.divide(instant.overlap, either, out=np.zeros_like(either), where=either > _EPSILON)
        alignment[np.ix_(instant.objects, instant.hypotheses)] += share
    alignment /= np.maximum(counts - alignment, _EPSILON)
    matches = np.zeros((len(_OVERLAPS), *alignment.shape))
    for instant in instants:
        rows, columns = linear_sum_assignment(
            alignment[np.ix_(instant.objects, instant.hypotheses)] * instant.overlap, maximize=True
        )
        matched = instant.overlap[rows, columns] >= _OVERLAPS[:, None] - _EPSILON
        matches[:, instant.objects[rows], instant.hypotheses[columns]] += matched
    true = matches.sum((1, 2))
    det_a = true / np.maximum(1, total - true)
    together = (matches * matches / np.maximum(1, counts - matches)).sum((1, 2))
    return det_a, together / np.maximum(1, true)


def _idf1(instants: list[_Instant], counts: NDArray[np.intp], total: int) -> float:
    """F1 score of the one assignment of hypotheses to objects that is right most often (Ristani et al.)."""
    together = np.zeros(counts.shape)
    for instant in instants:
        together[np.ix_(instant.objects, instant.hypotheses)] += instant.overlap >= _THRESHOLD
    right = together[linear_sum_assignment(together, maximize=True)].sum()
    return float(2 * right / max(1.0, total))


def _switches(instants: list[_Instant], objects: int) -> int:
    """How often an object is matched with another hypothesis than when it was matched last (CLEAR MOT)."""
    ever, last = np.full(objects, -1), np.full(objects, -1)
    switches = 0
    for instant in instants:
        stays = last[instant.objects][:, None] == instant.hypotheses[None, :]
        score = np.where(instant.overlap >= _THRESHOLD - _EPSILON, instant.overlap + _STAYS * stays, 0.0)
        rows, columns = linear_sum_assignment(score, maximize=True)
        matched = score[rows, columns] > _EPSILON
        true, hypotheses = instant.objects[rows[matched]], instant.hypotheses[columns[matched]]
        switches += int(np.count_nonzero((ever[true] >= 0) & (ever[true] != hypotheses)))
        last[:] = -1
        ever[true] = last[true] = hypotheses
    return switches
