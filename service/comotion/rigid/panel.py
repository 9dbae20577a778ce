"""Trajectories that speak for all where there are many: what no hypothesis explains, and a few of each.

Which hypotheses there are is decided on a bounded panel, so that the search costs the same however
many trajectories a scene has; its outcome is judged by all of them. A scene that is no larger than the
panel is its own panel.
"""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Ints
from ..compiled import compiled
from ..config import RigidConfig
from ..partition import NO_HYPOTHESIS
from .assignment import DEAD_FRAMES
from .bodies import Costs
from .frames import Frames

FEW = 160
"""Rows up to which everybody sits on the panel."""
# Most members of the panel in all, and of one hypothesis; fewer of each where hypotheses are many.
_SPEAKERS, _OF_EACH, _LEAST = 80, 8, 3
# Trajectories that a hypothesis does not explain, by how many standard deviations of its cost, and how
# many of them are sure of a seat: the rest is drawn, so that persistent outliers leave room for others.
_STRANGE = 4.5
_STRANGEST = 32
# A hypothesis whose median cost is so much beyond the noise explains nothing.
_WORST = 2.0
ENOUGH = 64
"""Most rows that a body's poses are fitted to; more would not make them better by what matters."""
# Share of those that may be dead: they hold the poses from before the living were born.
_DEAD_SHARE = 0.25


def panel(
    frames: Frames, newest: Floats, before: NDArray[np.int64], strange: Floats, judged: Bools
) -> Ints | None:
    """Trajectories that decide which hypotheses there are, ascending; None where all do.

    Parameters
    ----------
    newest, before
        float64 [N, 3], newest position; int64 [N], hypothesis until now.
    strange
        float64 [N], by :func:`strangeness` at the last update.
    judged
        bool [N], trajectories long enough to have a say.
    """
    if len(frames.owner) <= FEW:
        return None
    odd = unexplained(before, strange) & judged & frames.alive
    hypotheses = np.setdiff1d(before[judged & ~odd], NO_HYPOTHESIS).tolist()
    each = int(np.clip(_SPEAKERS // max(len(hypotheses), 1), _LEAST, _OF_EACH))
    seats = [speakers(frames, newest, judged & ~odd & (before == h), each) for h in hypotheses]
    left = max(FEW - sum(len(s) for s in seats), FEW - _SPEAKERS)
    return np.unique(np.concatenate([*seats, _drawn(np.flatnonzero(odd), before, strange, frames, left)]))


def unexplained(before: NDArray[np.int64], strange: Floats) -> Bools:
    """Trajectories that belong to no hypothesis, or hardly to theirs, bool [N]."""
    return np.asarray((before == NO_HYPOTHESIS) | (strange > _STRANGE), np.bool_)


def _drawn(odd: Ints, before: NDArray[np.int64], strange: Floats, frames: Frames, seats: int) -> Ints:
    """The strangest members of hypotheses, then others by a draw that depends on the instant alone."""
    if len(odd) <= seats:
        return odd
    members = odd[before[odd] != NO_HYPOTHESIS]
    first = members[np.argsort(-strange[members], kind="stable")[:_STRANGEST]]
    rest = np.setdiff1d(odd, first)
    draw = np.random.default_rng(int(frames.stamps[-1])).permutation(rest)
    return np.concatenate([first, draw[: seats - len(first)]])


def representatives(frames: Frames, newest: Floats, members: Bools) -> Ints:
    """Rows that a body's motion is fitted to, of `members` bool [N]: all where they are few."""
    rows = frames.rows_of(members)
    if len(rows) <= ENOUGH:
        return rows
    return frames.rows_of(speakers(frames, newest, members, ENOUGH))


def speakers(frames: Frames, newest: Floats, members: Bools, seats: int) -> Ints:
    """At most so many of `members` bool [N]: long-lived, spread in space, and some that have died."""
    telling = members & (frames.alive | (frames.life >= DEAD_FRAMES))
    living, dead = np.flatnonzero(telling & frames.alive), np.flatnonzero(telling & ~frames.alive)
    if len(living) + len(dead) <= seats:
        return np.flatnonzero(telling)
    some = _oldest(frames, dead, max(int(_DEAD_SHARE * seats), seats - len(living)))
    pool = _oldest(frames, living, 4 * seats)
    spread = pool[_farthest(newest[pool], seats - len(some))] if len(pool) > seats - len(some) else pool
    return np.concatenate([spread, some])


def _oldest(frames: Frames, tracks: Ints, count: int) -> Ints:
    return tracks[np.argsort(-frames.life[tracks], kind="stable")[:count]]


@compiled()
def _farthest(x: Floats, count: int) -> Ints:
    """Indices of `count` of the points x [n, 3], each the farthest from those before; the first is 0."""
    found = np.zeros(count, np.intp)
    nearest = np.full(len(x), np.inf)
    for k in range(1, count):
        best, last = 0, found[k - 1]
        for i in range(len(x)):
            squared = (x[i, 0] - x[last, 0]) ** 2 + (x[i, 1] - x[last, 1]) ** 2 + (x[i, 2] - x[last, 2]) ** 2
            nearest[i] = min(nearest[i], squared)
            if nearest[i] > nearest[best]:
                best = i
        found[k] = best
    return found


def strangeness(evidence: Costs, labels: Ints, config: RigidConfig) -> Floats:
    """By how much each trajectory's cost exceeds what is usual in its hypothesis, in its spread, float64 [N].

    Half a squared residual per coordinate and frame is expected, with a variance of as much.
    """
    found = np.zeros(len(labels))
    expected = np.maximum(evidence.outlier / (config.outlier_share * config.residual_cap), 1e-9)
    for k in range(evidence.body.shape[1]):
        members = np.flatnonzero(labels == k)
        if len(members):
            paid, due = evidence.body[members, k], expected[members]
            usual = min(float(np.median(paid / due)), _WORST)
            found[members] = (paid - usual * due) / np.sqrt(due)
    return found
