"""The method of the thesis (``method = "thesis"``): trajectories in, a partition by affinity out.

    pairs (3.2, 3.3, 3.5) -> affinity (3.4) -> clustering (3.6) -> label propagation (comotion.matching)

A group here is a cluster; of its motion no more is said than whether it moves.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Ints, Slots
from ..config import FusionConfig
from ..matching import largest_first
from ..partition import Group, Partition, Previous, Rows, SpaceSpec
from ..trajectories.interpolation import recent_steps
from ..trajectories.window import Window
from .affinity import Affinity
from .clustering import ClusterFunction, make_clustering
from .pairs import Pairs

# A velocity is taken over this long: at 15 Hz noise moves a single step as much as slow motion does.
_VELOCITY_NS = 500_000_000


class ThesisMethod:
    """The method of the thesis, for one space.

    Parameters
    ----------
    config
        Its group `thesis` matters here.
    spec
        The space.
    cluster
        In place of the configuration's clustering.
    """

    matching = staticmethod(largest_first)

    def __init__(self, config: FusionConfig, spec: SpaceSpec, cluster: ClusterFunction | None = None) -> None:
        self._sigma_switch = config.thesis.switch_for(spec.unit)
        v_move = config.thesis.v_move_for(spec.unit)
        # With equal weights there still is a speed from which on a hypothesis is said to move.
        self._v_moving = v_move or FusionConfig().thesis.v_move_for(spec.unit) or math.inf
        self._pairs = Pairs(v_move)
        self._cluster = cluster or make_clustering(config.thesis.clustering, config.thesis.stop_affinity)
        self._affinity = Affinity.of(np.zeros((0, 0)))

    def observed(self, window: Window, rows: Rows) -> None:
        """One instant of one source has been stored."""
        self._pairs.observed(window, rows)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest observations of some slots are about to go."""
        self._pairs.evicting(window, slots, counts)

    def forgetting(self, window: Window, slots: Slots) -> None:  # noqa: ARG002
        """Slots are about to be freed."""
        self._pairs.forget(slots)

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:  # noqa: ARG002
        """Group the current trajectories."""
        self._affinity = affinity = self._pairs.affinity(window, current, self._sigma_switch)
        clusters = self._cluster(affinity)
        return Partition(
            slots=current,
            groups=clusters.labels,
            deciding=np.ones(len(current), np.bool_),
            confidence=clusters.cohesion,
            position=window.positions[current, window.stop[current] - 1],
            described=self._describe(window, current, clusters.labels),
        )

    def affinity(self) -> NDArray[np.float32]:
        """Affinity [n, n] of the last update's trajectories."""
        return self._affinity.dense()

    def state(self) -> dict[str, Any]:
        """Nothing: the sums follow from the window."""
        return {}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Compute the sums anew from the window."""
        del state
        self._pairs.rebuild(window, window.slots())

    def _describe(self, window: Window, current: Slots, groups: Ints) -> list[Group]:
        sizes = np.bincount(groups)
        step, took = recent_steps(window, current, _VELOCITY_NS)
        velocity = step / np.where(took > 0, took * 1e-9, 1.0)[:, None]
        speeds = np.linalg.norm(_means(velocity, groups, sizes), axis=1)
        return [Group("moving" if speed > self._v_moving else "undetermined") for speed in speeds.tolist()]


def _means(values: Floats, group: Slots, sizes: Slots) -> Floats:
    """Mean of each group of rows, float64 [groups, dim]."""
    return np.column_stack([np.bincount(group, column) / sizes for column in values.T])
