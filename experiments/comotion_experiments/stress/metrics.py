"""The labels of a run at each update beside the truth, and metrics that users feel. Pure.

Two bodies can be distinguished from when on they have moved against each other by five sigma.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth, labels_of, score_labels
from comotion_clients.scoring import Observed
from comotion_schemas import UNDETERMINED, HypothesisUpdate
from comotion_sources.simulator.actors import Poses

from ..inputs import Arrived
from ..offline import Run, run_offline
from ..tables import mean
from .observe import EPOCH_NS, messages_of
from .scene import Array, Happening, Scene

SIGMAS = 5.0
_GRID_S = 0.05


@dataclass(frozen=True)
class Apart:
    """When each pair of bodies has moved apart: `since` float64 [B, B], s; infinite if never."""

    since: Array

    def components(self, t: float) -> NDArray[np.intp]:
        """Number the sets of bodies that nothing has separated until t, intp [B]."""
        groups: NDArray[np.intp] = connected_components(self.since > t, directed=False)[1].astype(np.intp)
        return groups

    def onset(self, body: int) -> float:
        """When a body is apart from every other, s; infinite if never."""
        return float(np.delete(self.since[body], body).max(initial=0.0))


def apart(scene: Scene) -> Apart:
    """Find when the features of each pair of bodies have moved against each other.

    The measure is the root mean square over the features of one body of how far they have moved in the
    frame of the other since the scene's start; of the two ways round the smaller one.
    """
    times = np.arange(scene.start, scene.duration + _GRID_S, _GRID_S)
    poses = [body.motion(times) for body in scene.bodies]
    count = len(poses)
    since = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i):
            bound = SIGMAS * max(scene.bodies[i].sigma, scene.bodies[j].sigma)
            moved = np.minimum(_moved(scene, poses, i, j), _moved(scene, poses, j, i)) > bound
            if moved.any():
                since[i, j] = since[j, i] = times[int(moved.argmax())]
    return Apart(since)


def _moved(scene: Scene, poses: list[Poses], body: int, frame: int) -> Array:
    """Root mean square distance of a body's features from where they were in another's frame, [T]."""
    back = np.swapaxes(poses[frame].rotations, 1, 2)
    turn = back @ poses[body].rotations
    shift = np.einsum("tij,tj->ti", back, poses[body].translations - poses[frame].translations)
    # The first place of every slot of the body.
    rows = np.flatnonzero(scene.lives.body == body)
    _, first = np.unique(scene.lives.slot[rows], return_index=True)
    places = np.einsum("tij,nj->tni", turn, scene.lives.local[rows[first]]) + shift[:, None]
    return np.asarray(np.sqrt(((places - places[0]) ** 2).sum(axis=2).mean(axis=1)), np.float64)


UNEVENTFUL = frozenset({"joined", "released"})
"""Kinds of events about joints between hypotheses, not of the set of hypotheses."""


@dataclass(frozen=True)
class Moment:
    """One update over the tracks observed at its stamp."""

    t: float  # s of the scene
    labels: NDArray[np.int64]  # [N], hypothesis id; UNDETERMINED for a track that has none
    bodies: NDArray[np.int64]  # [N], index of the true body
    confirmed: frozenset[int]  # ids of the confirmed hypotheses among the labels
    events: tuple[str, ...]  # kinds of the events of this update
    nmi: float  # against the true bodies
    nmi_apart: float  # with bodies as one that nothing has separated yet


def watch(scene: Scene, config: FusionConfig, apart: Apart) -> tuple[Run, list[Moment]]:
    """Run a scene through the core; the run, and every update of it."""
    messages = messages_of(scene)
    truth, observed, moments = Truth(messages.truth), Observed(), list[Moment]()
    listed: set[tuple[int, str, int, tuple[int, ...]]] = set()

    def passing() -> Iterator[Arrived]:
        for arrived in messages.batches:
            observed.add(arrived.batch)
            yield arrived

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        t = (update.stamp_ns - EPOCH_NS) / 1e9
        labels, bodies = labels_of(update, truth, observed.at(update.stamp_ns))
        together = apart.components(t)[bodies].astype(np.int32)
        confirmed = {h.id for h in update.hypotheses if h.confirmed}
        # Each event is repeated for some seconds.
        events = {(e.stamp_ns, e.kind, e.hypothesis, tuple(e.others)) for e in update.events}
        new = sorted(events - listed)
        listed.update(events)
        moments.append(
            Moment(
                t=t,
                labels=labels,
                bodies=bodies.astype(np.int64),
                confirmed=frozenset(labels[labels != UNDETERMINED].tolist()) & confirmed,
                events=tuple(kind for _, kind, _, _ in new if kind not in UNEVENTFUL),
                nmi=score_labels(labels, bodies, 0).nmi,
                nmi_apart=score_labels(labels, together, 0).nmi,
            )
        )

    run = run_offline(passing(), config, truth=truth, period=scene.period, on_update=on_update)
    return run, moments


GOOD = 0.95
"""NMI from which on a scene counts as right."""
_MAJORITY = 0.8
_STEADY_S = 3.0
_FALLEN_S = 1.0
_KEPT_AFTER_S = 2.0
# An update at the instant of an event has its stamp up to rounding.
_SAME_S = 1e-6


def mean_nmi(
    moments: Sequence[Moment], start: float = -np.inf, stop: float = np.inf, *, apart: bool = True
) -> float:
    """Mean NMI over the updates within a time; NaN without any.

    With bodies as one until they have moved `apart`, or against the true bodies.
    """
    return mean([m.nmi_apart if apart else m.nmi for m in moments if start <= m.t < stop])


def delays(moments: Sequence[Moment], apart: Apart, last: float) -> list[float]:
    """How long after it is apart from all others each body has a hypothesis of its own, s.

    A hypothesis is a body's own if it holds four fifths of its tracks, and these are four fifths of the
    hypothesis. A body that never gets one counts with the time that was left; one that never moves
    apart is left out.
    """
    delays = []
    for body in range(len(apart.since)):
        onset = apart.onset(body)
        if not np.isfinite(onset):
            continue
        own = (m.t for m in moments if m.t >= onset and has_own(m, body))
        delays.append(max(next(own, last) - onset, 0.0))
    return delays


def has_own(m: Moment, body: int) -> bool:
    """Whether a hypothesis stands for a body and for nothing else."""
    own = m.bodies == body
    identity = majority(m, body)
    members = m.labels == identity
    shared = np.count_nonzero(own & members)
    return identity is not None and bool(
        shared >= _MAJORITY * np.count_nonzero(own) and shared >= _MAJORITY * np.count_nonzero(members)
    )


def majority(m: Moment, body: int) -> int | None:
    """Hypothesis of most tracks of a body; None without any that has one."""
    counts = Counter(m.labels[(m.bodies == body) & (m.labels != UNDETERMINED)].tolist())
    return max(counts, key=lambda number: (counts[number], -number)) if counts else None


def ids_per_object(moments: Sequence[Moment], apart: Apart) -> float:
    """Mean over bodies of how many confirmed hypotheses held most of a body's tracks at some update.

    Counted from the first update at which the body has a hypothesis of its own. NaN if no body has.
    """
    counts = []
    for body in range(len(apart.since)):
        first = next((m.t for m in moments if m.t >= apart.onset(body) and has_own(m, body)), np.inf)
        ids = {majority(m, body) for m in moments if m.t >= first}
        confirmed = {m for moment in moments for m in moment.confirmed}
        if np.isfinite(first):
            counts.append(len(ids & confirmed))
    return mean(counts)


def healing(moments: Sequence[Moment], event: Happening, until: float) -> float:
    """How long after an event the grouping is right again, s; 0 if it stayed right.

    Right is an NMI of :data:`GOOD` at an update and in the mean of the three seconds after it. What is never
    right again before `until` (s) counts with the time that was left. NaN without updates.
    """
    after = [m for m in moments if event.end <= m.t <= until and len(m.labels)]
    fallen = [m.t for m in after if m.t <= event.end + _FALLEN_S and m.nmi_apart < GOOD]
    if not after:
        return float("nan")
    if not fallen:
        return 0.0
    for m in after:
        steady = mean_nmi(after, m.t, m.t + _STEADY_S)
        if m.t > fallen[0] and m.nmi_apart >= GOOD and steady >= GOOD:
            return m.t - event.end
    return until - event.end


def kept(moments: Sequence[Moment], event: Happening) -> float:
    """Share of the bodies concerned that bear the same id before an event and a while after it.

    An id that several bodies bear counts for one of them. NaN if no body was concerned.
    """
    earlier = [m for m in moments if m.t < event.begin - _SAME_S and len(m.labels)]
    later = [m for m in moments if event.end <= m.t <= event.end + _KEPT_AFTER_S and len(m.labels)]
    if not earlier or not later:
        return float("nan")
    ids = [(majority(earlier[-1], body), majority(later[-1], body)) for body in event.bodies]
    same = {old for old, new in ids if old is not None and old == new}
    return len(same) / len(ids) if ids else float("nan")
