"""Metrics that users feel: delays, healing, lasting ids, spurious events. Pure functions of moments."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from comotion_schemas import UNDETERMINED

from ..tables import mean
from .apart import Apart
from .moments import Moment
from .scene import Happening

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
    mine = m.bodies == body
    identity = majority(m, body)
    members = m.labels == identity
    shared = np.count_nonzero(mine & members)
    return identity is not None and bool(
        shared >= _MAJORITY * np.count_nonzero(mine) and shared >= _MAJORITY * np.count_nonzero(members)
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
        known = {m for moment in moments for m in moment.confirmed}
        if np.isfinite(first):
            counts.append(len(ids & known))
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


def true_events(apart: Apart, end: float, happenings: Sequence[Happening]) -> int:
    """Count the changes of the set of hypotheses that a right run shows.

    Bodies born at the start, a split for each that moves apart, and two for each whose features were all
    lost for a time.
    """
    births = int(apart.components(end).max()) + 1
    returns = sum(2 * len(h.bodies) for h in happenings if h.lost and h.end > h.begin)
    return births + returns
