"""Search for the bodies of a scene: propose, fit, select, assign, and again with what was found."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..engine import NO_HYPOTHESIS
from ..window import Floats
from .assignment import DEAD_FRAMES, Assignment, assign, cheapest
from .bodies import Body, Costs, costs, fit, static_body
from .config import MotionConfig
from .frames import Frames
from .identity import columns_before, match
from .proposals import adopt, propose
from .selection import select
from .tracks import Ints

# Candidates are compared on this many frames; what is chosen is fitted to all.
_KEY_FRAMES = 50
_ROUNDS = 2
# The dead tell how bodies moved, but a hypothesis is for the living.
_DEAD_SAY = 0.5


@dataclass(frozen=True)
class Found:
    """Bodies of a scene, the static one first, and the trajectories' assignment to them.

    `evidence` holds the costs before any prior.
    """

    bodies: list[Body]
    assignment: Assignment
    evidence: Costs


def search(
    frames: Frames, newest: Floats, before: NDArray[np.int64], static: int | None, config: MotionConfig
) -> Found:
    """Bodies and assignment of least cost, as far as a local search finds them.

    Parameters
    ----------
    newest
        float64 [N, 3], newest position of each trajectory.
    before
        int64 [N], hypothesis of each trajectory until now; these are candidates too.
    static
        Id of the hypothesis that was the static one.
    """
    judged = frames.life >= config.min_samples
    bodies, labels = _first(frames, before, static, judged, config)
    bodies = [static_body(len(frames.stamps)), *bodies[1:]]
    for round_ in range(_ROUNDS):
        bodies = _refit(frames, bodies, labels, judged, keep=round_ == 0)
        found = costs(frames, bodies, config)
        chosen = select(_of(frames, found, judged))
        bodies = [bodies[k] for k in chosen]
        evidence = Costs(found.body[:, chosen], found.outlier, found.opening[chosen])
        rough = cheapest(evidence.body, evidence.outlier)
        stays = columns_before(before, match(rough, before, len(bodies)))
        where = _carried(frames, newest, bodies, rough)
        assignment = assign(frames, evidence.body, evidence.outlier, stays, where, config)
        labels = assignment.labels
    return Found(bodies, assignment, evidence)


def _first(
    frames: Frames,
    before: NDArray[np.int64],
    static: int | None,
    judged: NDArray[np.bool_],
    config: MotionConfig,
) -> tuple[list[Body], Ints]:
    """Best of the previous hypotheses and the proposals, on few frames."""
    stride = max(len(frames.stamps) // _KEY_FRAMES, 1)
    few = _thinned(frames, stride) if stride > 1 else frames
    groups = [
        frames.rows_of(before == h) for h in np.unique(before).tolist() if h not in (NO_HYPOTHESIS, static)
    ]
    groups = [rows for rows in groups if len(rows) >= 2]
    strays = np.flatnonzero((before == NO_HYPOTHESIS) & few.alive & judged)
    groups += adopt(few, groups, strays) + propose(few, few.rows_of(few.alive & judged))
    bodies = [static_body(len(few.stamps)), *(fit(few, rows) for rows in groups)]
    found = costs(few, bodies, config, len(frames.stamps) / len(few.stamps))
    chosen = select(_of(frames, found, judged))
    return [bodies[k] for k in chosen], cheapest(found.body[:, chosen], found.outlier)


def _thinned(frames: Frames, stride: int) -> Frames:
    """Every stride-th frame, counted back from the newest."""
    kept = np.arange(len(frames.stamps) - 1, -1, -stride)[::-1]
    return replace(
        frames,
        stamps=frames.stamps[kept],
        y=np.ascontiguousarray(frames.y[:, kept]),
        w=np.ascontiguousarray(frames.w[:, kept]),
    )


def _of(frames: Frames, found: Costs, judged: NDArray[np.bool_]) -> Costs:
    """Costs of those that have a say in which hypotheses there are."""
    say = np.where(frames.alive, 1.0, _DEAD_SAY)[judged]
    return Costs(found.body[judged] * say[:, None], found.outlier[judged] * say, found.opening)


def _refit(
    frames: Frames, bodies: list[Body], labels: Ints, judged: NDArray[np.bool_], *, keep: bool
) -> list[Body]:
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
    row_of = np.searchsorted(np.sort(frames.owner), np.arange(len(labels)))
    first_row = np.argsort(frames.owner, kind="stable")[row_of]
    for i in np.flatnonzero(~frames.alive & (labels > 0)).tolist():
        body, row = bodies[labels[i]], first_row[i]
        both = np.flatnonzero((frames.w[row] > 0) & body.posed)
        if len(both):
            last, now = both[-1], np.flatnonzero(body.posed)[-1]
            inside = body.R[last].T @ (frames.y[row, last] - body.t[last])
            found[i] = body.R[now] @ inside + body.t[now]
    return found
