"""Baseline: a straightforward version of the thesis method in NumPy, with 2-means of scikit-learn.

Observations are stored by source, frame and feature, so that all operations are on arrays. The sums are
incremental, with one pass over all pairs for each instant that enters or leaves the window.
"""

import math
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans

from comotion import FusionConfig
from comotion.thesis.equations import weight as velocity_weight
from comotion_schemas import ObservationBatch

from .scene import Scene, SceneSpec

Floats = NDArray[np.float64]
_STOP = 0.4


@dataclass
class _Source:
    """Frames of one source: stamps, and positions [rows, 3], NaN where unobserved."""

    row_of: dict[int, int] = field(default_factory=dict)
    stamps: deque[int] = field(default_factory=deque)
    frames: deque[Floats] = field(default_factory=deque)

    def state(self, stamp: int) -> tuple[Floats, Floats, bool]:
        """Positions and speeds of its rows at a time, and whether there is a frame at this time."""
        stamps = np.array(self.stamps)
        k = int(np.searchsorted(stamps, stamp, side="right")) - 1
        exact = bool(stamps[k] == stamp)
        left, right = (max(k - 1, 0), k) if exact else (k, k + 1)
        a, b = self.frames[left], self.frames[right]
        seconds = max(stamps[right] - stamps[left], 1) * 1e-9
        share = (stamp - stamps[left]) / max(stamps[right] - stamps[left], 1)
        return a + share * (b - a), np.linalg.norm(b - a, axis=1) / seconds, exact


class Straightforward:
    """Incremental sums in NumPy over a fixed number of rows; clustering by KMeans with ten starts."""

    def __init__(self, rows: int, config: FusionConfig) -> None:
        self._v_move, self._switch = config.thesis.v_move_for("m"), config.thesis.switch_for("m")
        self._span = round(config.window * 1e9)
        self._sources: dict[str, _Source] = {}
        self._rows = rows
        self._free = list(range(rows))
        self._done: deque[int] = deque()
        self._weight, self._first, self._second = (np.zeros((rows, rows)) for _ in range(3))

    def ingest(self, batch: ObservationBatch) -> None:
        """Store a frame; assign rows to new features and free those of ended features."""
        source = self._sources.setdefault(batch.source, _Source())
        for gone in batch.ended.tolist() if batch.ended is not None else ():
            self._clear(source.row_of.pop(gone))
        frame = np.full((self._rows, 3), np.nan)
        for k, track in enumerate(batch.ids.tolist()):
            if track not in source.row_of:
                source.row_of[track] = self._free.pop()
            frame[source.row_of[track]] = batch.positions[k]
        source.stamps.append(batch.stamp_ns)
        source.frames.append(frame)

    def _clear(self, row: int) -> None:
        self._free.append(row)
        for sums in (self._weight, self._first, self._second):
            sums[row] = sums[:, row] = 0.0
        for source in self._sources.values():
            for frame in source.frames:
                frame[row] = np.nan

    def advance(self) -> None:
        """Add the instants that all sources have passed, and remove those before the window."""
        last = min(source.stamps[-1] for source in self._sources.values())
        first = max(source.stamps[0] for source in self._sources.values())
        every = sorted(t for source in self._sources.values() for t in source.stamps)
        fresh = [t for t in every if first <= t <= last and (not self._done or t > self._done[-1])]
        for stamp in fresh:
            self._add(stamp, 1.0)
            self._done.append(stamp)
        while self._done and self._done[0] < last - self._span:
            self._add(self._done.popleft(), -1.0)
        for source in self._sources.values():
            while len(source.stamps) > 2 and source.stamps[1] < last - self._span:
                source.stamps.popleft()
                source.frames.popleft()

    def _add(self, stamp: int, sign: float) -> None:
        position, speed = np.full((self._rows, 3), np.nan), np.zeros(self._rows)
        observed = np.zeros(self._rows, np.bool_)
        for source in self._sources.values():
            where, fast, exact = source.state(stamp)
            rows = ~np.isnan(where[:, 0])
            position[rows], speed[rows], observed[rows] = where[rows], fast[rows], exact
        held = np.flatnonzero(~np.isnan(position[:, 0]))
        distance = cdist(position[held], position[held])
        weight = velocity_weight(speed[held], self._v_move)
        share = sign * np.maximum.outer(weight, weight) * np.logical_or.outer(observed[held], observed[held])
        pairs = np.ix_(held, held)
        self._weight[pairs] += share
        self._first[pairs] += share * distance
        self._second[pairs] += share * distance**2

    def cluster(self) -> tuple[list[tuple[str, int]], NDArray[np.intp]]:
        """Cluster the tracks: returns the tracks and the cluster of each."""
        tracks = [(name, track) for name, source in self._sources.items() for track in source.row_of]
        rows = np.array([self._sources[name].row_of[track] for name, track in tracks])
        weight, first, second = (m[np.ix_(rows, rows)] for m in (self._weight, self._first, self._second))
        known = weight > 1e-9
        weight = np.where(known, weight, 1.0)
        variance = np.maximum(second / weight - (first / weight) ** 2, 0.0)
        affinity = np.where(known, np.exp(math.log(0.5) / self._switch**2 * variance), 0.5)
        np.fill_diagonal(affinity, 1.0)
        return tracks, divide(affinity)


def divide(affinity: Floats, stop_affinity: float = _STOP) -> NDArray[np.intp]:
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


@dataclass(frozen=True)
class Baseline:
    """Cost of an update of the baseline in ms of wall clock, and the NMI of the updates."""

    features: int
    sums_ms: float
    clustering_ms: float
    nmi: float

    @property
    def update_ms(self) -> float:
        """Cost of the NumPy version."""
        return self.sums_ms + self.clustering_ms


def time_straightforward(spec: SceneSpec, config: FusionConfig, updates: int) -> Baseline:
    """Run the baseline until the window is full, then time some updates."""
    from comotion_clients.metrics import nmi

    scene = Scene(spec)
    work = Straightforward(spec.features + 64, config)
    seconds = config.window + (updates + 3) * config.period
    due = scene.start_ns + round((config.window + 2 * config.period) * 1e9)
    sums, clustering, agreement, busy = [], [], [], 0.0
    for batch in scene.merged(seconds):
        begun = time.perf_counter()
        work.ingest(batch)
        busy += time.perf_counter() - begun
        if batch.stamp_ns < due:
            continue
        begun = time.perf_counter()
        work.advance()
        middle = time.perf_counter()
        if due > scene.start_ns + round((config.window + 2 * config.period) * 1e9):
            tracks, labels = work.cluster()
            clustering.append(1e3 * (time.perf_counter() - middle))
            sums.append(1e3 * (busy + middle - begun))
            agreement.append(nmi(labels, np.array([scene.truth[s][i] for s, i in tracks])))
        due, busy = due + round(config.period * 1e9), 0.0
    return Baseline(
        spec.features,
        float(np.median(sums)),
        float(np.median(clustering)),
        float(np.mean(agreement)),
    )
