"""The method of the thesis (``method = "thesis"``): groups trajectories by affinity.

To be read beside "Inferring Object Hypotheses Based on Feature Motion from Different Sources":

1. Trajectories: observations of the last `window` seconds, in order of time (:mod:`comotion.trajectories`).
2. Distance samples (3.5): at each observation of either trajectory of a pair, the other is interpolated.
3. Weights (3.2): a sample counts the more, the faster one of the two moves.
4. Variance (3.3) of the distance and affinity (3.4), for every pair.
5. Divisive k-means (3.6): clusters are halved while they hold a pair of small affinity.
6. Label propagation: a cluster continues the hypothesis with which it shares the most trajectories
   (:mod:`comotion.hypotheses`, by :func:`comotion.matching.largest_first`).

Steps 2 to 4 follow the changes of the window for all pairs (:mod:`~comotion.thesis.pair_sums`). As the thesis
states them, for one pair, they are in `tests/reference/thesis.py`, which a test compares.
"""

import numpy as np

from ..arrays import Floats32, Ints, Slots
from ..config import FusionConfig, Unit
from ..partition import Group, Method, Partition, Previous, SpaceSpec
from ..trajectories.window import Window
from .clustering import make_clustering
from .pair_sums import PairSums

# Velocities span half a second: in a single step at 15 Hz, noise moves a feature as far as slow motion does.
_VELOCITY_SPAN_NS = 500_000_000
# What "null" of `sigma_switch` and "auto" of `v_move` stand for, by unit of the space.
_SIGMA_SWITCH: dict[Unit, float] = {"m": 0.02, "px": 8.0}
_V_MOVE: dict[Unit, float] = {"m": 0.1, "px": 20.0}


class ThesisMethod(Method):
    """The method of the thesis, for one space."""

    # Section 3.3 propagates the labels of the last update, those of all features alike.
    by_thesis = True

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:
        thesis = config.thesis
        v_move = _V_MOVE[spec.unit] if thesis.v_move == "auto" else thesis.v_move
        # With equal weights there still is a speed from which on a hypothesis counts as moving.
        self._v_moving = v_move or _V_MOVE[spec.unit]
        self._pair_sums = PairSums(v_move, thesis.sigma_switch or _SIGMA_SWITCH[spec.unit])
        self._cluster = make_clustering(thesis.clustering, thesis.stop_affinity)
        self._affinity: Floats32 = np.zeros((0, 0), np.float32)
        # The last update's trajectories: which of its rows are theirs.
        self._current: Slots = np.zeros(0, np.intp)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest observations of some slots are about to go."""
        self._pair_sums.evicting(window, slots, counts)

    def forgetting(self, window: Window, slots: Slots) -> None:  # noqa: ARG002
        """Slots are about to be freed."""
        self._pair_sums.forget(slots)

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:  # noqa: ARG002
        """Group the current trajectories."""
        # 1. Trajectories: the window holds them up to date; `current` are those to group.
        # 2. to 4. Distance samples (3.5), weights (3.2), variance (3.3) and affinity (3.4) of all pairs.
        self._affinity = self._pair_sums.affinity(window)
        self._current = current
        # 5. Divisive k-means (3.6), or an alternative that the thesis compares it with.
        groups, cohesion = self._cluster(self._affinity, current)
        # 6. Label propagation is up to the caller: every trajectory here decides which hypothesis continues.
        return Partition(
            slots=current,
            groups=groups,
            deciding=np.ones(len(current), np.bool_),
            confidence=cohesion,
            position=window.newest(current),
            described=self._describe(window, current, groups),
        )

    def affinity(self) -> Floats32:
        """Affinity [n, n] of the last update's trajectories."""
        return self._affinity[np.ix_(self._current, self._current)]

    def _describe(self, window: Window, current: Slots, groups: Ints) -> list[Group]:
        """Whether each cluster moves; the thesis estimates no more of its motion."""
        sizes = np.bincount(groups)
        step, elapsed = window.recent_steps(current, _VELOCITY_SPAN_NS)
        velocity = step / np.where(elapsed > 0, elapsed * 1e-9, 1.0)[:, None]
        means = np.column_stack([np.bincount(groups, along) / sizes for along in velocity.T])
        speeds = np.linalg.norm(means, axis=1)
        return [Group("moving" if speed > self._v_moving else "undetermined") for speed in speeds.tolist()]
