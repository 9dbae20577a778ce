"""The method of the thesis (``method = "thesis"``), from observations to hypotheses.

    pairs (3.2, 3.3, 3.5) -> affinity (3.4) -> clustering (3.6) -> label propagation

A hypothesis here is a cluster with a name; of its motion no more is said than whether it moves.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis

from ..arrays import Floats, Slots
from ..config import FusionConfig
from ..hypotheses.labels import LabelMemory
from ..hypotheses.propagation import propagate
from ..partition import IdAllocator, Partition, Rows, SpaceSpec
from ..trajectories.interpolation import recent_steps
from ..trajectories.window import Window
from .affinity import Affinity
from .clustering import ClusterFunction, make_clustering
from .pairs import Pairs

# A velocity is taken over this long: at 15 Hz noise moves a single step as much as slow motion does.
_VELOCITY_NS = 500_000_000


class ThesisEngine:
    """Engine of one space.

    Parameters
    ----------
    config
        `sigma_switch`, `v_move`, `clustering` and `stop_affinity` matter here.
    spec
        The space.
    ids
        Where new hypotheses get their ids.
    cluster
        In place of the configuration's clustering.
    """

    def __init__(
        self, config: FusionConfig, spec: SpaceSpec, ids: IdAllocator, cluster: ClusterFunction | None = None
    ) -> None:
        self._spec = spec
        self._ids = ids
        self._sigma_switch = config.switch_for(spec.unit)
        v_move = config.v_move_for(spec.unit)
        # With equal weights there still is a speed from which on a hypothesis is said to move.
        self._v_moving = v_move or FusionConfig().v_move_for(spec.unit) or math.inf
        self._pairs = Pairs(v_move)
        self._cluster = cluster or make_clustering(config.clustering, config.stop_affinity)
        self._memory = LabelMemory()
        self._affinity = Affinity.of(np.zeros((0, 0)))

    def observed(self, window: Window, rows: Rows) -> None:
        """One instant of one source has been stored."""
        self._pairs.observed(window, rows)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest observations of some slots are about to go."""
        self._pairs.evicting(window, slots, counts)

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""
        self._pairs.forget(slots)
        self._memory.forget(window, slots)

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories."""
        self._memory.fit(window)
        self._affinity = affinity = self._pairs.affinity(window, current, self._sigma_switch)
        clusters = self._cluster(affinity)
        held = self._memory.label[current]
        labels = propagate(held, clusters.labels, self._ids.next)
        self._memory.lead(window, current, held, labels)
        self._memory.label[current] = labels
        events = self._memory.note(window, stamp_ns)
        hypotheses = self._describe(window, current, labels)
        return Partition(labels, clusters.cohesion, hypotheses, events)

    def affinity(self) -> NDArray[np.float32]:
        """Affinity [n, n] of the last update's trajectories."""
        return self._affinity.dense()

    def state(self, window: Window) -> dict[str, Any]:
        """Labels of all trajectories, and since when there are the hypotheses."""
        return self._memory.state(window)

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up labels; the sums are computed anew from the window."""
        self._pairs.rebuild(window, window.slots())
        self._memory.load(state, window)

    def _describe(self, window: Window, current: Slots, labels: NDArray[np.int64]) -> list[Hypothesis]:
        found, group = np.unique(labels, return_inverse=True)
        sizes = np.bincount(group)
        step, took = recent_steps(window, current, _VELOCITY_NS)
        velocity = step / np.where(took > 0, took * 1e-9, 1.0)[:, None]
        speeds = np.linalg.norm(_means(velocity, group, sizes), axis=1)
        centroids = _means(window.positions[current, window.stop[current] - 1], group, sizes)
        return [
            Hypothesis(
                id=label,
                space=self._spec.name,
                size=size,
                born_ns=self._memory.born_ns[label],
                state="moving" if speed > self._v_moving else "undetermined",
                centroid=centroid,
            )
            for label, size, speed, centroid in zip(
                found.tolist(), sizes.tolist(), speeds.tolist(), centroids.tolist(), strict=True
            )
        ]


def _means(values: Floats, group: Slots, sizes: Slots) -> Floats:
    """Mean of each group of rows, float64 [groups, dim]."""
    return np.column_stack([np.bincount(group, column) / sizes for column in values.T])
