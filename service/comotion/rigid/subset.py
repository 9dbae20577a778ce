"""In rows and earlier hypotheses, out the trajectories that are searched for bodies: all of a small scene.

In a large scene they are what no hypothesis explains, and a few representatives of each hypothesis. Their
number is bounded, so that the search costs the same however many trajectories a scene has. All trajectories
are then compared with the bodies that are found.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels
from ..matching import continued, largest_total
from ..partition import NO_HYPOTHESIS
from .assignment import OUTLIER
from .frames import Frames
from .kernels.distances import farthest_points

# All constants here bound the work of an update. They were chosen on the scenes of docs/research/accuracy.md
# and on made-up crowds of thousands of features (tests/unit/test_rigid_scale.py).

SUBSET_ROWS = 160
"""Rows up to which a scene is searched as a whole; and most trajectories of a subset."""
# Representatives of one hypothesis at most and at least; of all hypotheses together, half of the subset.
_MOST_OF_EACH, _LEAST_OF_EACH = 8, 3
# So many unexplained members of hypotheses are taken first, by their excess. The rest is drawn, so that
# lasting outliers leave room for others.
_LARGEST_EXCESS = 32
FIT_ROWS = 64
"""Most rows that a body is fitted to in a large scene."""
# Share of representatives that may be ended trajectories: they hold the poses from before others were born.
_ENDED_SHARE = 0.25
# Representatives are chosen among so many times as many, the ones with the longest life.
_LONGEST_LIVED = 4
# Label of a trajectory that is not in the subset.
_OUTSIDE = -2


@dataclass(frozen=True)
class Scene:
    """What is searched for bodies: N trajectories, and what is known of them from the last update.

    Attributes
    ----------
    frames
        Their rows.
    newest
        float64 [N, 3], newest position.
    judged
        bool [N], observed in enough frames to be searched.
    before
        int64 [N], hypothesis of each trajectory; these hypotheses are candidates again.
    static
        Hypothesis that was the static one.
    separate
        bool [N], whether the hypothesis is known to be a body of its own.
    resting
        bool [N], whether it is, and did not clearly move.
    clear
        bool [N], whether the trajectory has clearly been a member of its hypothesis.
    """

    frames: Frames
    newest: Floats
    judged: Bools
    before: Labels
    static: int | None
    separate: Bools
    resting: Bools
    clear: Bools

    @property
    def small(self) -> bool:
        """Whether all trajectories are searched."""
        return len(self.frames.owner) <= SUBSET_ROWS

    def of(self, tracks: Ints) -> "Scene":
        """Some of the trajectories, intp [n] ascending."""
        every = "newest", "judged", "before", "separate", "resting", "clear"
        columns = {one: getattr(self, one)[tracks] for one in every}
        return replace(self, frames=self.frames.of(tracks), **columns)


@dataclass(frozen=True)
class Subset:
    """Trajectories that are searched for bodies.

    `tracks` intp [n], ascending; `unexplained` bool [n], whether no hypothesis explains them. In a small
    scene, everyone is in it and counts as unexplained, so that every cluster is a candidate.
    """

    tracks: Ints
    unexplained: Bools


def choose_subset(scene: Scene, odd: Bools, excess: Floats) -> Subset:
    """Choose the trajectories that are searched for bodies.

    Parameters
    ----------
    odd, excess
        bool [N], what the known bodies do not explain, and float64 [N], by how much.
    """
    frames, before = scene.frames, scene.before
    if scene.small:
        return Subset(np.arange(len(before)), np.ones(len(before), np.bool_))
    explained = scene.judged & ~odd
    hypotheses = np.setdiff1d(before[explained], NO_HYPOTHESIS).tolist()
    most = SUBSET_ROWS // 2
    each = int(np.clip(most // max(len(hypotheses), 1), _LEAST_OF_EACH, _MOST_OF_EACH))
    found = [representatives(frames, scene.newest, explained & (before == h), each) for h in hypotheses]
    left = max(SUBSET_ROWS - sum(len(some) for some in found), SUBSET_ROWS - most)
    found.append(_drawn(np.flatnonzero(odd), before, excess, int(frames.stamps[-1]), left))
    tracks = np.unique(np.concatenate(found))
    return Subset(tracks, odd[tracks])


def unexplained(scene: Scene, labels: Ints, excess: Floats) -> Bools:
    """Which current trajectories belong to nobody, or exceed the usual by more than chance, bool [N].

    That is three standard deviations, and more among many: the largest of n normal deviates is about the
    root of 2 log n. `labels` intp [N] are those of followed bodies, `excess` float64 [N] that of
    :func:`~comotion.rigid.costs.excess_costs`.
    """
    asked = scene.judged & scene.frames.current
    most = max(3.0, float(np.sqrt(2 * np.log(max(int(asked.sum()), 1)))))
    return np.asarray(asked & ((labels == OUTLIER) | (excess > most)), np.bool_)


def known_rows(scene: Scene) -> list[Ints]:
    """Rows to fit each known hypothesis but the static one to; two at least."""
    known = np.setdiff1d(scene.before, [NO_HYPOTHESIS, -1 if scene.static is None else scene.static])
    telling = scene.frames.telling
    found = [_rows_of_representatives(scene, (scene.before == one) & telling) for one in known.tolist()]
    return [rows for rows in found if len(rows) >= 2]


def extended_rows(scene: Scene, subset: Subset, labels: Ints, bodies: int) -> list[Ints]:
    """Rows to fit each body to, from all trajectories that it probably moves.

    They are the representatives of its members in the subset and, outside it, of the hypothesis that it
    continues. Each hypothesis that none of the bodies continues is one more body.

    Parameters
    ----------
    labels
        intp [n], body of each trajectory of the subset: 0 for the static one, below 0 for an outlier.
    bodies
        Number of bodies in the subset, with the static one.
    """
    before = scene.before[subset.tracks]
    # Of the subset only explained trajectories are drawn in proportion to their hypotheses.
    fair = (labels > 0) & ~subset.unexplained & (before != scene.static)
    heirs = continued(before[fair], labels[fair], bodies, largest_total)
    column = np.full(len(scene.before), _OUTSIDE)
    column[subset.tracks] = labels
    groups = [
        (column == k) | ((column == _OUTSIDE) & (scene.before == heirs.get(k, _OUTSIDE)))
        for k in range(1, bodies)
    ]
    done = {scene.static, NO_HYPOTHESIS, *heirs.values()}
    groups += [scene.before == h for h in np.unique(scene.before).tolist() if h not in done]
    return [_rows_of_representatives(scene, group & scene.judged) for group in groups]


def representatives(frames: Frames, newest: Floats, members: Bools, count: int) -> Ints:
    """At most so many of `members` bool [N], intp [n]: spread in space, long-lived, a few of them ended.

    An ended trajectory must have been observed long enough.
    """
    telling = members & frames.telling
    current, ended = np.flatnonzero(telling & frames.current), np.flatnonzero(telling & ~frames.current)
    if len(current) + len(ended) <= count:
        return np.flatnonzero(telling)
    some = _longest_lived(frames, ended, max(int(_ENDED_SHARE * count), count - len(current)))
    pool, left = _longest_lived(frames, current, _LONGEST_LIVED * count), count - len(some)
    spread = pool[farthest_points(newest[pool], left)] if len(pool) > left else pool
    return np.concatenate([spread, some])


def _rows_of_representatives(scene: Scene, members: Bools) -> Ints:
    """Rows of `members` bool [N]: all of them if they are few, else those of representatives."""
    rows = scene.frames.rows_of(members)
    if len(rows) <= FIT_ROWS:
        return rows
    return scene.frames.rows_of(representatives(scene.frames, scene.newest, members, FIT_ROWS))


def _drawn(odd: Ints, before: Labels, excess: Floats, seed: int, count: int) -> Ints:
    """At most so many of `odd`: members of hypotheses by largest excess, then others by lot, intp [n].

    The draw depends on the time of the update alone.
    """
    if len(odd) <= count:
        return odd
    members = odd[before[odd] != NO_HYPOTHESIS]
    first = members[np.argsort(-excess[members], kind="stable")[:_LARGEST_EXCESS]]
    rest = np.setdiff1d(odd, first)
    draw = np.random.default_rng(seed).permutation(rest)
    return np.concatenate([first, draw[: count - len(first)]])


def _longest_lived(frames: Frames, tracks: Ints, count: int) -> Ints:
    return tracks[np.argsort(-frames.life[tracks], kind="stable")[:count]]
