"""Chooses the trajectories that are searched for bodies, so that the work of a search is bounded (step 5).

In a small scene they are all. In a large one they are those that no hypothesis explains, and a few
representatives of each hypothesis. All trajectories are then compared with the bodies that are found.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels
from ..geometry.frames import ENOUGH, FEW, Frames
from ..partition import NO_HYPOTHESIS
from .assignment import OUTLIER, SearchResult
from .costs import excess_costs
from .kernels.distances import farthest_points

# All constants here bound the work of an update. They were chosen on the scenes of docs/research/accuracy.md
# and on made-up crowds of thousands of features (tests/unit/test_rigid_scale.py).

SUBSET_ROWS = 160
"""Rows up to which a scene is searched as a whole; and most trajectories of a subset."""
MOST_OF_EACH = 8
"""Most representatives of one hypothesis; of all hypotheses together, they are half of the subset."""
# Representatives are chosen among the longest-lived trajectories, this many for each. One in as many may have
# ended: they determine poses before others were born.
_LONGEST_LIVED = 4


@dataclass(frozen=True)
class Scene:
    """N trajectories of an update, and the results of earlier updates for them.

    Attributes
    ----------
    frames
        Their rows.
    newest
        float64 [N, 3], newest position.
    judged
        bool [N], observed in enough frames to be searched.
    hypotheses
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
    hypotheses: Labels
    static: int | None
    separate: Bools
    resting: Bools
    clear: Bools

    @property
    def small(self) -> bool:
        """Whether all trajectories are searched."""
        return is_small(self.frames)

    def of(self, tracks: Ints) -> "Scene":
        """Some of the trajectories, intp [n] ascending."""
        names = "newest", "judged", "hypotheses", "separate", "resting", "clear"
        columns = {name: getattr(self, name)[tracks] for name in names}
        return replace(self, frames=self.frames.of(tracks), **columns)


def is_small(frames: Frames) -> bool:
    """Whether a scene is searched as a whole."""
    return len(frames.owner) <= SUBSET_ROWS


def choose_subset(scene: Scene, outlying: Bools) -> Ints:
    """Choose the trajectories that are searched for bodies, intp [n] ascending: all in a small scene.

    `outlying` bool [N] are those that the known bodies do not explain. Of many some are drawn by the time of
    the update, so that lasting ones do not exclude others.
    """
    frames, hypotheses = scene.frames, scene.hypotheses
    if scene.small:
        return np.arange(len(hypotheses))
    explained = scene.judged & ~outlying
    explaining = np.setdiff1d(hypotheses[explained], NO_HYPOTHESIS).tolist()
    most = SUBSET_ROWS // 2
    each = int(np.clip(most // max(len(explaining), 1), FEW, MOST_OF_EACH))
    groups = [representatives(frames, scene.newest, explained & (hypotheses == h), each) for h in explaining]
    remaining = max(SUBSET_ROWS - sum(len(group) for group in groups), SUBSET_ROWS - most)
    draw = np.random.default_rng(int(frames.stamps[-1])).permutation(np.flatnonzero(outlying))[:remaining]
    return np.unique(np.concatenate([*groups, draw]))


def unexplained(scene: Scene, result: SearchResult) -> Bools:
    """Which current trajectories are outliers, or exceed the usual cost by more than chance, bool [N].

    That is three standard deviations, and more among many: the largest of n normal deviates is about the
    root of 2 log n.
    """
    labels, eligible = result.assignment.labels, scene.judged & scene.frames.current
    most = max(3.0, float(np.sqrt(2 * np.log(max(int(eligible.sum()), 1)))))
    excess = excess_costs(result.evidence, labels)
    return np.asarray(eligible & ((labels == OUTLIER) | (excess > most)), np.bool_)


def known_rows(scene: Scene) -> list[Ints]:
    """Rows to fit each known hypothesis but the static one to; two at least."""
    hypotheses = np.setdiff1d(scene.hypotheses, [NO_HYPOTHESIS, -1 if scene.static is None else scene.static])
    usable = scene.frames.informative
    groups = [rows_to_fit(scene, (scene.hypotheses == h) & usable) for h in hypotheses.tolist()]
    return [rows for rows in groups if len(rows) >= 2]


def representatives(frames: Frames, newest: Floats, members: Bools, count: int) -> Ints:
    """At most `count` of `members` bool [N], intp [n]: spread in space, long-lived, a few of them ended.

    An ended trajectory must have been observed long enough.
    """
    usable = members & frames.informative
    current, ended = np.flatnonzero(usable & frames.current), np.flatnonzero(usable & ~frames.current)
    if len(current) + len(ended) <= count:
        return np.flatnonzero(usable)
    chosen_ended = _longest_lived(frames, ended, max(count // _LONGEST_LIVED, count - len(current)))
    pool, left = _longest_lived(frames, current, _LONGEST_LIVED * count), count - len(chosen_ended)
    chosen_current = pool[farthest_points(newest[pool], left)] if len(pool) > left else pool
    return np.concatenate([chosen_current, chosen_ended])


def rows_to_fit(scene: Scene, members: Bools) -> Ints:
    """Rows of `members` bool [N]: all of them if they are few, else those of representatives."""
    rows = scene.frames.rows_of(members)
    if len(rows) <= ENOUGH:
        return rows
    return scene.frames.rows_of(representatives(scene.frames, scene.newest, members, ENOUGH))


def _longest_lived(frames: Frames, tracks: Ints, count: int) -> Ints:
    return tracks[np.argsort(-frames.life[tracks], kind="stable")[:count]]
