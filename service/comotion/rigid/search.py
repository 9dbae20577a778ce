"""Search for the bodies of a scene: propose, fit, select, assign, and again with what was found.

In a large scene a panel of trajectories does so, and all judge what it has found.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Ints
from ..compiled import compiled
from ..config import RigidConfig
from ..matching import continued, largest_total
from ..partition import NO_HYPOTHESIS
from .assignment import DEAD_FRAMES, OUTLIER, Assignment, assign, cheapest
from .bodies import Body, Costs, costs, fit, moving, static_body
from .frames import Frames
from .panel import FEW, panel, representatives, strangeness, unexplained
from .proposals import adopt, propose
from .selection import select

# Candidates are compared on this many frames; what is chosen is fitted to all.
_KEY_FRAMES = 50
_ROUNDS = 2
# Of a scene beyond so many panels a panel's first look at what sets off is too thin: it takes background
# along, and waiting for one update more is better.
_FULL = 4
# Rows up to which a body may turn about itself unseen.
_SMALL = 3
# Where trajectories are many, most motions are out of the question for each after a look at every so
# many frames.
_FIRST_LOOK = 5
# The dead tell how bodies moved, but a hypothesis is for the living.
_DEAD_SAY = 0.5
UNSEATED = -2
"""Column of a trajectory that is not on the panel."""


@dataclass(frozen=True)
class Found:
    """Bodies of a scene, the static one first, and the trajectories' assignment to them.

    `evidence` holds the costs before any prior, `strange` float64 [N] how badly each trajectory fits.
    """

    bodies: list[Body]
    assignment: Assignment
    evidence: Costs
    strange: Floats


@dataclass(frozen=True)
class Past:
    """What is known of N trajectories from the last update.

    Attributes
    ----------
    labels
        int64 [N], hypothesis of each trajectory; these are candidates too.
    static
        Id of the hypothesis that was the static one.
    strange
        float64 [N], `strange` of what was found.
    """

    labels: NDArray[np.int64]
    static: int | None
    strange: Floats

    def of(self, tracks: Ints) -> "Past":
        """That of some trajectories."""
        return Past(self.labels[tracks], self.static, self.strange[tracks])


def search(frames: Frames, newest: Floats, past: Past, config: RigidConfig) -> Found:
    """Bodies and assignment of least cost, as far as a local search finds them.

    Parameters
    ----------
    newest
        float64 [N, 3], newest position of each trajectory.
    """
    judged = frames.life >= config.min_samples
    if FEW < len(frames.owner) <= _FULL * FEW:
        past = _of_now(frames, past, config)
    chosen = panel(frames, newest, past.labels, past.strange, judged)
    if chosen is not None:
        bodies = _by_panel(frames, newest, past, judged, chosen, config)
        return _settled(frames, newest, bodies, past, judged, config, _FIRST_LOOK)
    bodies, labels = _first(frames, past, judged, np.ones(len(judged), np.bool_), config)
    bodies = [static_body(len(frames.stamps)), *bodies[1:]]
    for round_ in range(_ROUNDS):
        bodies = _refit(frames, bodies, labels, judged, keep=round_ == 0)
        found = _settled(frames, newest, bodies, past, judged, config)
        bodies, labels = found.bodies, found.assignment.labels
    return found


def _of_now(frames: Frames, past: Past, config: RigidConfig) -> Past:
    """The past, but what was at rest judged by what is seen of it now: what sets off is heard at once."""
    resting = past.labels == past.static
    now = costs(frames, [static_body(len(frames.stamps))], config)
    strange = strangeness(now, np.where(resting, 0, OUTLIER), config)
    return replace(past, strange=np.where(resting, strange, past.strange))


def _settled(
    frames: Frames,
    newest: Floats,
    bodies: list[Body],
    past: Past,
    judged: Bools,
    config: RigidConfig,
    stride: int = 1,
) -> Found:
    """The best of bodies, and everybody's assignment to them."""
    found = costs(frames, bodies, config, stride=stride)
    if stride > 1:
        kept = moving(frames, bodies, found, config)
        bodies, found = [bodies[k] for k in kept], found.of(kept)
    chosen = select(_of(frames, found, judged))
    bodies, evidence = [bodies[k] for k in chosen], found.of(chosen)
    rough = cheapest(evidence.body, evidence.outlier)
    stays = _columns_before(past.labels, _continued(rough, past.labels, len(bodies)))
    where = _carried(frames, newest, bodies, rough)
    assignment = assign(frames, evidence.body, evidence.outlier, stays, where, config)
    return Found(bodies, assignment, evidence, strangeness(evidence, assignment.labels, config))


def _by_panel(
    frames: Frames, newest: Floats, past: Past, judged: Bools, chosen: Ints, config: RigidConfig
) -> list[Body]:
    """The static body, those that the panel finds, and those that were there before.

    Poses are fitted to representatives of all that the panel's word goes for.
    """
    seated = past.of(chosen)
    open_ = unexplained(seated.labels, seated.strange)
    bodies, labels = _first(frames.of(chosen), seated, judged[chosen], open_, config)
    # Of those on the panel only the ones a hypothesis explains are a fair share of it.
    fair = (labels > 0) & ~open_ & (seated.labels != past.static)
    heirs = _continued(labels[fair], seated.labels[fair], len(bodies))
    column = np.full(len(judged), UNSEATED)
    column[chosen] = labels
    groups = [
        (column == k) | ((column == UNSEATED) & (past.labels == heirs.get(k, UNSEATED)))
        for k in range(1, len(bodies))
    ]
    kept = {past.static, NO_HYPOTHESIS, *heirs.values()}
    groups += [past.labels == h for h in np.unique(past.labels).tolist() if h not in kept]
    rows = [representatives(frames, newest, group & judged) for group in groups]
    return [static_body(len(frames.stamps)), *(fit(frames, some) for some in rows if len(some) >= 2)]


def _first(
    frames: Frames, past: Past, judged: Bools, open_: Bools, config: RigidConfig
) -> tuple[list[Body], Ints]:
    """Best of the previous hypotheses and the proposals, on few frames.

    A proposal inside one hypothesis without anyone of `open_` bool [N] is no news, and a body of more
    than a pair takes up strays without being proposed to.
    """
    stride = max(len(frames.stamps) // _KEY_FRAMES, 1)
    few = frames.thinned(stride) if stride > 1 else frames
    before = past.labels
    known = [h for h in np.unique(before).tolist() if h not in (NO_HYPOTHESIS, past.static)]
    groups = [rows for h in known if len(rows := frames.rows_of(before == h)) >= 2]
    strays = np.flatnonzero((before == NO_HYPOTHESIS) & few.alive & judged)
    kind = np.where(open_, NO_HYPOTHESIS, before)[frames.owner]
    proposed = propose(few, few.rows_of(few.alive & judged))
    groups += adopt(few, groups if open_.all() else [r for r in groups if len(r) <= _SMALL], strays)
    groups += [r for r in proposed if (kind[r] == NO_HYPOTHESIS).any() or (kind[r] != kind[r[0]]).any()]
    bodies = [static_body(len(few.stamps)), *(fit(few, rows) for rows in groups)]
    found = costs(few, bodies, config, len(frames.stamps) / len(few.stamps))
    chosen = select(_of(frames, found, judged))
    return [bodies[k] for k in chosen], cheapest(found.body[:, chosen], found.outlier)


def _of(frames: Frames, found: Costs, judged: Bools) -> Costs:
    """Costs of those that have a say in which hypotheses there are."""
    say = np.where(frames.alive, 1.0, _DEAD_SAY)[judged]
    return Costs(found.body[judged] * say[:, None], found.outlier[judged] * say, found.opening)


def _refit(frames: Frames, bodies: list[Body], labels: Ints, judged: Bools, *, keep: bool) -> list[Body]:
    """Each body fitted to the trajectories assigned to it; and, with `keep`, to those it came with."""
    telling = judged & (frames.alive | (frames.life >= DEAD_FRAMES))
    found = [bodies[0]]
    for k, body in enumerate(bodies[1:], 1):
        rows = frames.rows_of((labels == k) & telling)
        if len(rows) >= 2:
            found.append(fit(frames, rows))
        if keep and len(body.rows) >= 2 and not np.array_equal(rows, body.rows):
            found.append(fit(frames, body.rows))
    return found


def _carried(frames: Frames, newest: Floats, bodies: list[Body], labels: Ints) -> Floats:
    """Where each trajectory is now: its newest position; the dead where their body has carried them."""
    found = newest.copy()
    dead = ~frames.alive & (labels > 0)
    # A trajectory's first row is its place, or one of its arms.
    rows = np.flatnonzero(dead[frames.owner])
    tracks, first = np.unique(frames.owner[rows], return_index=True)
    for k, body in enumerate(bodies):
        mine = labels[tracks] == k
        if mine.any() and body.posed.any():
            _carry(frames.y, frames.w, rows[first[mine]], tracks[mine], body.R, body.t, body.posed, found)
    return found


@compiled()
def _carry(
    y: Floats, w: Floats, rows: Ints, tracks: Ints, R: Floats, t: Floats, posed: Bools, where: Floats
) -> None:
    """Put each track where the pose that its row was last seen in has moved to, in place."""
    now = len(posed) - 1
    while not posed[now]:
        now -= 1
    for n in range(len(rows)):
        i, last = rows[n], len(posed) - 1
        while last >= 0 and not (posed[last] and w[i, last] > 0):
            last -= 1
        if last < 0:
            continue
        for c in range(3):
            where[tracks[n], c] = t[now, c]
        for d in range(3):
            inside = 0.0
            for c in range(3):
                inside += R[last, c, d] * (y[i, last, c] - t[last, c])
            for c in range(3):
                where[tracks[n], c] += R[now, c, d] * inside


def _continued(labels: Ints, before: NDArray[np.int64], bodies: int) -> dict[int, int]:
    """Hypothesis that each body continues, {column: id}: most shared trajectories in all."""
    return continued(before, labels, bodies, largest_total)


def _columns_before(before: NDArray[np.int64], matched: dict[int, int]) -> Ints:
    """Column of the body that continues each trajectory's hypothesis, or -1, intp [N]."""
    found = np.full(len(before), -1, np.intp)
    for k, hypothesis in matched.items():
        found[before == hypothesis] = k
    return found
