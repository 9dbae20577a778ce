"""Baselines: the thesis method with 2-means as everybody has it, and complete linkage.

The first shows what our own splits cost or gain. The second is on the standard deviation of pairwise
distances, with a fixed threshold.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform
from sklearn.cluster import KMeans

from comotion import Fusion, FusionConfig
from comotion.partition import Method, SpaceSpec
from comotion.thesis.clustering import Clusters, by_appearance
from comotion.thesis.method import ThesisMethod
from comotion_clients.metrics import Truth, nmi
from comotion_schemas import ObservationBatch, TruthBatch

from ..offline import Message
from .study import PERIOD, Array

CUT = 0.005
_WINDOW_S = 10.0
_RATE = 15.0


class ReferenceFusion(Fusion):
    """Fusion of which every space is split by scikit-learn's 2-means, the best of ten random starts."""

    def make_method(self, spec: SpaceSpec) -> Method:
        """Build the thesis method with the other split."""
        return ThesisMethod(self.config, spec, lambda affinity, _: _split(affinity, self.config))


def _split(affinity: NDArray[np.float32], config: FusionConfig) -> Clusters:
    dense = affinity.astype(float)
    labels = by_appearance(_divided(dense, config.thesis.stop_affinity))
    # Confidence is no part of what is compared.
    return Clusters(labels, dense.mean(axis=1))


def _divided(affinity: Array, stop_affinity: float) -> NDArray[np.intp]:
    """Divisive k-means (3.6) by scikit-learn's KMeans with ten random starts: labels intp [n]."""
    labels, pending, found = np.zeros(len(affinity), np.intp), [np.arange(len(affinity))], 0
    while pending:
        members = pending.pop()
        rows = affinity[np.ix_(members, members)]
        if rows.min() > stop_affinity:
            labels[members] = found
            found += 1
            continue
        second = KMeans(2, n_init=10, random_state=0).fit_predict(rows) == 1
        pending += [members[second], members[~second]]
    return labels


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
