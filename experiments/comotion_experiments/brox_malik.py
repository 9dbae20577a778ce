"""Comparator: the affinity of Brox and Malik with two clusterings, on the trajectories of the window.

Brox and Malik (2010), "Object segmentation by long term analysis of point trajectories":

    d_t(A, B)² = d_sp(A, B) |m_t(A) - m_t(B)|² / (5 σ_t²)      (3)
    d(A, B)²   = max over the common time of d_t²              (2)
    w(A, B)    = exp(-λ d²), λ = 0.1                           (1)

m_t is the motion over five frames, d_sp the mean distance in the image over the common time, and σ_t the
local variation of the flow. We have trajectories and no flow field: σ_t² is the variance of the motion
among a trajectory's nearest neighbours, the smaller one of the pair, and not below the noise.
"""

import math
import warnings
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comotion.config import ThesisConfig
from comotion.thesis.clustering import make_clustering
from comotion_clients.metrics import Truth, nmi
from comotion_schemas import ObservationBatch, TruthBatch

from .inputs import Arrived, Incoming
from .tables import mean

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]
Objects = NDArray[np.int32]
Track = tuple[str, str, int]
History: TypeAlias = list[tuple[float, Floats]]
"""Times (s) and positions of one trajectory."""

STEP = 5
"""Frames over which motion is measured."""
LAMBDA = 0.1
NEIGHBOURS = 8
# λ is for distances in pixels. In metres the scene is scaled to so many units, which was best for the
# comparator among 500, 100, 30, 10 and 3, on seed 0 of fig. 4.1 and 4.4, 3d_3 and 3d_outliers.
_EXTENT = 3.0
_LEAST_NOISE = 1e-9
WINDOW_S, RATE_HZ, EVERY_S = 10.0, 15.0, 1.0
# s; nothing is interpolated across a longer gap, and what was not seen for so long is not current.
_GAP_S = 0.5
# Current trajectories with fewer frames in the window show too little motion over five of them. They count as
# clusters of their own, as undetermined ones do in the scores of our methods.
_LEAST_FRAMES = 8


def affinity(positions: Floats, *, pixels: bool) -> Floats:
    """Affinity of every pair of trajectories, float64 [N, N] in 0..1; 0 without common motion.

    `positions` are float64 [F, N, dim], NaN where unobserved; if not in `pixels`, lengths are scaled to a
    fixed width of the scene.
    """
    finite = positions[np.isfinite(positions).all(axis=2)]
    extent = float((finite.max(0) - finite.min(0)).max()) if len(finite) else 1.0
    scale = 1.0 if pixels else _EXTENT / max(extent, _LEAST_NOISE)
    x = positions * scale
    count = x.shape[1]
    motion = x[STEP:] - x[:-STEP]
    floor = 2 * _noise(x) ** 2
    largest = np.full((count, count), -1.0)
    distance, common = np.zeros((count, count)), np.zeros((count, count))
    for t in range(len(motion)):
        rows = np.flatnonzero(np.isfinite(motion[t]).all(axis=1))
        if len(rows) < 2:
            continue
        m, at = motion[t, rows], x[t, rows]
        # Variance of a coordinate of the motion among the nearest neighbours of each trajectory.
        near = min(NEIGHBOURS + 1, len(at))
        neighbours = cKDTree(at).query(at, k=near)[1].reshape(len(at), near)
        variation = np.maximum(m[neighbours].var(axis=1).mean(axis=1), floor)
        smaller = np.minimum(variation[:, None], variation[None])
        difference = ((m[:, None] - m[None]) ** 2).sum(2) / (STEP * smaller)
        cell = np.ix_(rows, rows)
        largest[cell] = np.maximum(largest[cell], difference)
        distance[cell] += np.linalg.norm(at[:, None] - at[None], axis=2)
        common[cell] += 1
    squared = distance / np.maximum(common, 1) * largest
    affinity = np.where(common > 0, np.exp(-LAMBDA * squared), 0.0)
    np.fill_diagonal(affinity, 1.0)
    return affinity


def _noise(x: Floats) -> float:
    """One-sigma noise of a coordinate: third differences of smooth motion are noise alone."""
    third = np.diff(x, n=3, axis=0)
    finite = third[np.isfinite(third)]
    # The variance of third differences is 20 times that of the noise.
    return float(np.median(np.abs(finite)) / 0.6745 / np.sqrt(20)) if len(finite) else _LEAST_NOISE


def spectral(matrix: NDArray[Any], count: int) -> Labels:
    """Spectral clustering (scikit-learn) of an affinity [N, N], number of objects given."""
    if count < 2 or len(matrix) <= count:
        return np.zeros(len(matrix), np.intp)
    # Slow to import, and few evaluations have the comparator.
    from sklearn.cluster import SpectralClustering

    # Without any affinity between groups the graph falls apart, which is no defect here.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        clustering = SpectralClustering(count, affinity="precomputed", random_state=0)
        return np.asarray(clustering.fit_predict(matrix), np.intp)


def divisive(matrix: Floats, count: int) -> Labels:
    """Divisive k-means of the thesis, which finds the number itself."""
    del count
    cluster = make_clustering("divisive-kmeans", ThesisConfig().stop_affinity)
    return cluster(matrix.astype(np.float32), np.arange(len(matrix)))[0]


CLUSTERINGS: dict[str, Callable[[Floats, int], Labels]] = {
    "spectral, K given": lambda matrix, count: spectral(np.maximum(matrix, 1e-9), count),
    "divisive k-means": divisive,
}


class _Scene:
    """Trajectories by space, as far as they have been seen."""

    def __init__(self) -> None:
        self.truth = Truth()
        self.units: dict[str, str] = {}
        self._tracks: dict[str, dict[Track, History]] = {}

    def add(self, batch: ObservationBatch, start_ns: int) -> None:
        self.units[batch.space] = batch.unit
        space = self._tracks.setdefault(batch.space, {})
        stamps = np.full(len(batch.ids), batch.stamp_ns) if batch.stamps_ns is None else batch.stamps_ns
        for identity, stamp, x in zip(batch.ids.tolist(), stamps.tolist(), batch.positions, strict=True):
            history = space.setdefault((batch.source, batch.session, identity), [])
            history.append(((stamp - start_ns) * 1e-9, x.astype(np.float64)))

    def window(self, space: str, now: float) -> tuple[Floats, Objects, Objects]:
        """Current trajectories: positions [F, N, dim] and objects [N] of long ones, objects [M] of others."""
        tracks = self._tracks[space]
        for key in [key for key, history in tracks.items() if history[-1][0] < now - _GAP_S]:
            del tracks[key]
        frames = np.arange(max(0.0, now - WINDOW_S), now + 1e-9, 1 / RATE_HZ)
        ids = ((key[:2], np.array([key[2]], np.uint64)) for key in tracks)
        objects = np.array([int(self.truth.objects(*track)[0]) for track in ids], np.int32)
        if not tracks:
            return np.zeros((len(frames), 0, 2)), objects, objects
        x = np.stack([_resampled(history, frames) for history in tracks.values()], axis=1)
        enough = np.isfinite(x[..., 0]).sum(axis=0) >= _LEAST_FRAMES
        return x[:, enough], objects[enough], objects[~enough]


def _resampled(history: History, frames: Floats) -> Floats:
    t, x = map(np.array, zip(*sorted(history, key=lambda observed: observed[0]), strict=True))
    places = np.column_stack([np.interp(frames, t, column) for column in x.T])
    after = np.searchsorted(t, frames).clip(1, max(len(t) - 1, 1))
    gap = t[np.minimum(after, len(t) - 1)] - t[after - 1]
    places[(frames < t[0]) | (frames > t[-1] + 1 / RATE_HZ) | (gap > _GAP_S)] = np.nan
    return places


def compare(messages: Iterable[Incoming], duration: float | None = None) -> dict[str, float]:
    """Score the affinity of Brox and Malik with each clustering: mean NMI over the whole seconds.

    `messages` are those of an offline run, in time order; `duration` is in s, all by default. NaN where
    nothing could be scored.
    """
    scene, scores = _Scene(), list[dict[str, float]]()
    start_ns: int | None = None
    due = 1
    for arrived in messages:
        message = arrived.batch if isinstance(arrived, Arrived) else arrived
        if isinstance(message, TruthBatch):
            scene.truth.add(message)
            continue
        start_ns = message.stamp_ns if start_ns is None else start_ns
        seconds = (message.stamp_ns - start_ns) * 1e-9
        while seconds > due * EVERY_S and (duration is None or due * EVERY_S <= duration):
            scores.append(_score(scene, due * EVERY_S))
            due += 1
        if duration is not None and seconds > duration:
            break
        scene.add(message, start_ns)
    return {name: mean([row.get(name, math.nan) for row in scores]) for name in CLUSTERINGS}


def _score(scene: _Scene, now: float) -> dict[str, float]:
    """NMI by clustering over all spaces; a cluster is of one space. Empty where there is nothing to score."""
    labels: dict[str, list[Labels]] = {name: [] for name in CLUSTERINGS}
    truths: list[Objects] = []
    for space, unit in sorted(scene.units.items()):
        positions, objects, others = scene.window(space, now)
        matrix = affinity(positions, pixels=unit == "px") if len(objects) else np.zeros((0, 0))
        count = len(np.unique(objects[objects >= 0]))
        for name, cluster in CLUSTERINGS.items():
            chosen = cluster(matrix, count) if len(objects) > 1 else np.zeros(len(objects), np.intp)
            offset = sum(int(part.max(initial=-1)) + 1 for part in labels[name])
            alone = int(chosen.max(initial=-1)) + 1 + np.arange(len(others))
            labels[name].append(np.concatenate([chosen, alone]) + offset)
        truths += [objects, others]
    objects = np.concatenate([np.zeros(0, np.int32), *truths])
    scored = objects >= 0
    if scored.sum() < 2:
        return {}
    return {name: nmi(np.concatenate(parts)[scored], objects[scored]) for name, parts in labels.items()}
