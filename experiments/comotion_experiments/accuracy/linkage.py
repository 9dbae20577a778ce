"""Baseline: complete linkage on the standard deviation of pairwise distances, with a fixed threshold."""

from collections.abc import Iterable

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from comotion_clients.metrics import Truth, nmi
from comotion_schemas import ObservationBatch, TruthBatch

from ..offline import Message
from .study import PERIOD, Array

CUT = 0.005
_WINDOW_S = 10.0
_RATE = 15.0


def linkage_nmi(messages: Iterable[Message], duration: float | None) -> Array:
    """Return the NMI at each update, float64 [updates], for one source in 3-D."""
    truth = Truth()
    batches = []
    for message in messages:
        if isinstance(message, TruthBatch):
            truth.add(message)
        else:
            batches.append(message)
    times, positions, ids, source = _table(batches)
    objects = truth.objects(source, ids)
    scores = []
    for due in np.arange(PERIOD, min(times[-1], duration or np.inf) + 1e-9, PERIOD):
        frames = np.arange(max(0.0, due - _WINDOW_S), due + 1e-9, 1 / _RATE)
        rows = np.unique(np.searchsorted(times, frames + 1e-9, side="right") - 1)
        newest = positions[rows[-1]]
        scored = np.isfinite(newest[:, 0]) & (objects >= 0)
        if scored.sum() > 1:
            scores.append(nmi(_clusters(positions[rows][:, scored]), objects[scored]))
    return np.array(scores)


def _table(batches: list[ObservationBatch]) -> tuple[Array, Array, np.ndarray, tuple[str, str]]:
    """Return seconds [F], positions [F, N, dim] (NaN where unobserved), ids [N] and the source."""
    ids = np.unique(np.concatenate([b.ids for b in batches]))
    positions = np.full((len(batches), len(ids), batches[0].dim), np.nan)
    for f, batch in enumerate(batches):
        positions[f, np.searchsorted(ids, batch.ids)] = batch.positions
    times = np.array([(b.stamp_ns - batches[0].stamp_ns) * 1e-9 for b in batches])
    return times, positions, ids, (batches[0].source, batches[0].session)


def _clusters(x: Array) -> np.ndarray:
    n = x.shape[1]
    deviation = np.zeros((n, n))
    for i in range(n):
        distance = np.linalg.norm(x - x[:, i : i + 1], axis=2)
        both = np.isfinite(distance).sum(0) >= 2
        deviation[i, both] = np.nanstd(distance[:, both], axis=0)
        deviation[i, ~both] = CUT
    condensed = squareform((deviation + deviation.T) / 2, checks=False)
    return np.asarray(fcluster(linkage(condensed, "complete"), CUT, "distance"))
