"""Keeps the updates of a run for plots, and picks the tracks of one space out of them."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from comotion_clients.metrics import Labels, Score, Truth
from comotion_clients.scoring import SpaceRef
from comotion_schemas import UNDETERMINED, HypothesisUpdate

_TRACE_LIMIT = 600


class Trace:
    """The updates of a run; a long run is reduced to a part of its updates."""

    def __init__(self) -> None:
        self.updates: list[HypothesisUpdate] = []
        self._stride = 1
        self._count = 0

    def add(self, update: HypothesisUpdate, score: Score | None = None) -> None:  # noqa: ARG002
        """Add an update; the score is ignored."""
        if self._count % self._stride == 0:
            self.updates.append(update)
        self._count += 1
        if len(self.updates) > _TRACE_LIMIT:
            del self.updates[1::2]
            self._stride *= 2


@dataclass(frozen=True)
class Moment:
    """The tracks of one space in one update: positions [N, dim], hypothesis ids and objects [N]."""

    stamp_ns: int
    tracks: list[tuple[str, str, int]]
    positions: NDArray[np.float32]
    hypotheses: NDArray[np.int64]
    objects: NDArray[np.int64]

    def of(self, rows: NDArray[np.bool_]) -> "Moment":
        """Some of the tracks, by a mask bool [N]."""
        tracks = [self.tracks[row] for row in np.flatnonzero(rows)]
        columns = (self.positions[rows], self.hypotheses[rows], self.objects[rows])
        return Moment(self.stamp_ns, tracks, *columns)


def main_space(updates: Sequence[HypothesisUpdate], spaces: Mapping[str, SpaceRef]) -> SpaceRef | None:
    """Find the space with most tracks; None without tracks."""
    counts = Counter[SpaceRef]()
    for update in updates:
        for index, source in enumerate(update.sources):
            if source.name in spaces:
                counts[spaces[source.name]] += int(np.count_nonzero(update.track_source == index))
    return next((space for space, count in counts.most_common(1) if count), None)


def moment_of(
    update: HypothesisUpdate, truth: Truth, spaces: Mapping[str, SpaceRef], space: SpaceRef
) -> Moment:
    """Select the tracks of a space in an update, with their true objects."""
    sources = [index for index, source in enumerate(update.sources) if spaces.get(source.name) == space]
    rows = np.flatnonzero(np.isin(update.track_source, sources))
    rows = rows[np.argsort(update.track_source[rows], kind="stable")]
    refs = (update.sources[index] for index in update.track_source[rows].tolist())
    return Moment(
        stamp_ns=update.stamp_ns,
        tracks=[(r.name, r.session, n) for r, n in zip(refs, update.track_id[rows].tolist(), strict=True)],
        positions=update.track_position[rows, : space.dim],
        hypotheses=update.track_hypothesis[rows].astype(np.int64),
        objects=objects_of(update, truth)[rows].astype(np.int64),
    )


def trails_of(
    moment: Moment, seen: Iterable[tuple[Sequence[tuple[str, str, int]], NDArray[np.float32]]]
) -> list[NDArray[np.float32]]:
    """Past positions of each track of a moment, float32 [steps, dim], from tracks and positions in order."""
    ways: dict[tuple[str, str, int], list[NDArray[np.float32]]] = {track: [] for track in moment.tracks}
    for tracks, positions in seen:
        for track, position in zip(tracks, positions, strict=True):
            if track in ways:
                ways[track].append(position)
    dim = moment.positions.shape[1]
    return [np.array(way, np.float32).reshape(-1, dim) for way in ways.values()]


def objects_of(update: HypothesisUpdate, truth: Truth) -> NDArray[np.int32]:
    """Return the true object of each track of an update, int32 [N]; -1 where unknown."""
    objects = np.full(len(update.track_id), -1, np.int32)
    for k, source in enumerate(update.sources):
        rows = update.track_source == k
        objects[rows] = truth.objects((source.name, source.session), update.track_id[rows])
    return objects


def rightly_assigned(labels: Labels, objects: Labels) -> NDArray[np.bool_]:
    """Whether the hypothesis of each track is the one assigned to its object, bool [N]."""
    pairs = list(zip(labels.tolist(), objects.tolist(), strict=True))
    object_of = matched(Counter(pairs))
    return np.array([object_of.get(hypothesis) == number for hypothesis, number in pairs])


def matched(votes: Mapping[tuple[int, int], int]) -> dict[int, int]:
    """Object of each hypothesis, assigned one to one so that most tracks are right (Hungarian method).

    `votes` are (hypothesis, object) -> tracks that they share; undetermined tracks and unknown objects do not
    count.
    """
    pairs = {pair: n for pair, n in votes.items() if pair[0] != UNDETERMINED and pair[1] >= 0}
    hypotheses, objects = sorted({h for h, _ in pairs}), sorted({o for _, o in pairs})
    counts = np.zeros((len(hypotheses), len(objects)))
    for (hypothesis, number), count in pairs.items():
        counts[hypotheses.index(hypothesis), objects.index(number)] = count
    rows, columns = linear_sum_assignment(counts, maximize=True)
    return {hypotheses[r]: objects[c] for r, c in zip(rows, columns, strict=True) if counts[r, c]}
