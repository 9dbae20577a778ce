"""Scores the comparator on the trajectories of the window, at every second."""

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion.config import ThesisConfig
from comotion.thesis.clustering import make_clustering
from comotion_clients.metrics import Truth, nmi
from comotion_schemas import ObservationBatch, TruthBatch

from ..inputs import Arrived, Incoming
from .pair_affinity import Floats, affinity

Labels = NDArray[np.intp]
Objects = NDArray[np.int32]
Track = tuple[str, str, int]

WINDOW_S, RATE_HZ, EVERY_S = 10.0, 15.0, 1.0
# s; nothing is interpolated across a longer gap, and what was not seen for so long is not current.
_GAP_S = 0.5
# Current trajectories with fewer frames in the window show too little motion over five of them. They count as
# clusters of their own, as undetermined ones do in the scores of our methods.
_LEAST_FRAMES = 8


def spectral(matrix: Floats, count: int) -> Labels:
    """Spectral clustering (scikit-learn), the number of objects given."""
    if count < 2 or len(matrix) <= count:
        return np.zeros(len(matrix), np.intp)
    # Slow to import, and few evaluations have the comparator.
    from sklearn.cluster import SpectralClustering

    # Without any affinity between groups the graph falls apart, which is no defect here.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        clustering = SpectralClustering(count, affinity="precomputed", random_state=0)
        return np.asarray(clustering.fit_predict(np.maximum(matrix, 1e-9)), np.intp)


def divisive(matrix: Floats, count: int) -> Labels:
    """Divisive k-means of the thesis, which finds the number itself."""
    del count
    cluster = make_clustering("divisive-kmeans", ThesisConfig().stop_affinity)
    return cluster(matrix.astype(np.float32), np.arange(len(matrix))).labels


CLUSTERINGS: dict[str, Callable[[Floats, int], Labels]] = {
    "spectral, K given": spectral,
    "divisive k-means": divisive,
}


@dataclass
class Comparison:
    """NMI at every second, by clustering."""

    seconds: list[float] = field(default_factory=list)
    scores: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in CLUSTERINGS})

    def means(self) -> dict[str, float]:
        """Mean NMI over time, NaN where nothing could be scored."""
        return {name: float(np.mean(values)) if values else math.nan for name, values in self.scores.items()}


@dataclass
class _History:
    """Observations of one trajectory."""

    t: list[float] = field(default_factory=list)
    x: list[Floats] = field(default_factory=list)


class _Scene:
    """Trajectories by space, as far as they have been seen."""

    def __init__(self) -> None:
        self.truth = Truth()
        self.units: dict[str, str] = {}
        self._tracks: dict[str, dict[Track, _History]] = {}

    def add(self, batch: ObservationBatch, start_ns: int) -> None:
        self.units[batch.space] = batch.unit
        space = self._tracks.setdefault(batch.space, {})
        stamps = np.full(len(batch.ids), batch.stamp_ns) if batch.stamps_ns is None else batch.stamps_ns
        for identity, stamp, x in zip(batch.ids.tolist(), stamps.tolist(), batch.positions, strict=True):
            history = space.setdefault((batch.source, batch.session, identity), _History())
            history.t.append((stamp - start_ns) * 1e-9)
            history.x.append(x.astype(np.float64))

    def window(self, space: str, now: float) -> tuple[Floats, Objects, Objects]:
        """Current trajectories: positions [F, N, dim] and objects [N] of long ones, objects [M] of others."""
        tracks = self._tracks[space]
        for key in [key for key, history in tracks.items() if history.t[-1] < now - _GAP_S]:
            del tracks[key]
        frames = np.arange(max(0.0, now - WINDOW_S), now + 1e-9, 1 / RATE_HZ)
        columns = [_resampled(history, frames) for history in tracks.values()]
        objects = np.array([self._object(key) for key in tracks], np.int32)
        enough = np.array([np.isfinite(column[:, 0]).sum() >= _LEAST_FRAMES for column in columns], np.bool_)
        if not enough.any():
            return np.zeros((len(frames), 0, 2)), np.zeros(0, np.int32), objects
        x = np.stack([column for column, good in zip(columns, enough, strict=True) if good], axis=1)
        return x, objects[enough], objects[~enough]

    def _object(self, track: Track) -> int:
        source, session, identity = track
        return int(self.truth.objects((source, session), np.array([identity], np.uint64))[0])


def _resampled(history: _History, frames: Floats) -> Floats:
    t, x = np.array(history.t), np.array(history.x)
    order = np.argsort(t, kind="stable")
    t, x = t[order], x[order]
    places = np.column_stack([np.interp(frames, t, column) for column in x.T])
    after = np.searchsorted(t, frames).clip(1, max(len(t) - 1, 1))
    gap = t[np.minimum(after, len(t) - 1)] - t[after - 1]
    places[(frames < t[0]) | (frames > t[-1] + 1 / RATE_HZ) | (gap > _GAP_S)] = np.nan
    return places


def compare(messages: Iterable[Incoming], duration: float | None = None) -> Comparison:
    """Score the affinity of Brox and Malik with each clustering at every second.

    Parameters
    ----------
    messages
        Of an offline run, in time order.
    duration
        Seconds; all by default.
    """
    scene, comparison = _Scene(), Comparison()
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
            _score(scene, due * EVERY_S, comparison)
            due += 1
        if duration is not None and seconds > duration:
            break
        scene.add(message, start_ns)
    return comparison


def _score(scene: _Scene, now: float, comparison: Comparison) -> None:
    """Score all spaces together; a cluster is of one space."""
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
        return
    comparison.seconds.append(now)
    for name, parts in labels.items():
        comparison.scores[name].append(nmi(np.concatenate(parts)[scored], objects[scored]))
