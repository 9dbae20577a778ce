"""The method of the thesis (``method = "thesis"``), from observations to hypotheses.

    pairs (3.2, 3.3, 3.5) -> affinity (3.4) -> clustering (3.6) -> label propagation

A hypothesis here is a cluster with a name; of its motion no more is said than whether it moves.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Hypothesis

from .affinity import Affinity
from .clustering import make_clustering
from .config import FusionConfig
from .engine import NO_HYPOTHESIS, IdAllocator, Partition, Rows, SpaceSpec
from .events import Membership, changes
from .pairs import Pairs
from .propagation import follow, propagate
from .states import locate
from .window import Floats, Slots, Window

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
    """

    def __init__(self, config: FusionConfig, spec: SpaceSpec, ids: IdAllocator) -> None:
        self._spec = spec
        self._ids = ids
        self._sigma_switch = config.switch_for(spec.unit)
        v_move = config.v_move_for(spec.unit)
        # With equal weights there still is a speed from which on a hypothesis is said to move.
        self._v_moving = v_move or FusionConfig().v_move_for(spec.unit) or math.inf
        self._pairs = Pairs(v_move)
        self._cluster = make_clustering(config.clustering, config.stop_affinity)
        self._label: NDArray[np.int64] = np.zeros(0, np.int64)
        self._born_ns: dict[int, int] = {}
        self._before = Membership.empty()
        self._affinity = Affinity.of(np.zeros((0, 0)))

    def observed(self, window: Window, rows: Rows) -> None:
        """One instant of one source has been stored."""
        self._pairs.observed(window, rows)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest observations of some slots are about to go."""
        self._pairs.evicting(window, slots, counts)

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""
        self._fit(window.capacity)
        self._pairs.forget(slots)
        self._label[slots] = NO_HYPOTHESIS

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories."""
        self._fit(window.capacity)
        self._affinity = affinity = self._pairs.affinity(window, current, self._sigma_switch)
        clusters = self._cluster(affinity)
        labels = propagate(self._label[current], clusters.labels, self._ids.next)
        self._relabel(window, current, labels)
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before = after
        alive = np.unique(after.labels).tolist()
        self._born_ns = {h: self._born_ns.get(h, stamp_ns) for h in alive}
        hypotheses = self._describe(window, current, labels)
        return Partition(labels, clusters.cohesion, hypotheses, events)

    def affinity(self) -> NDArray[np.float32]:
        """Affinity [n, n] of the last update's trajectories."""
        return self._affinity.dense()

    def state(self, window: Window) -> dict[str, Any]:
        """Labels of all trajectories, and since when there are the hypotheses."""
        slots = window.slots()
        self._fit(window.capacity)
        return {
            "tracks": window.key[slots],
            "labels": self._label[slots],
            "hypotheses": np.array(list(self._born_ns), np.int64),
            "born_ns": np.array(list(self._born_ns.values()), np.int64),
        }

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up labels; the sums are computed anew from the window."""
        self._fit(window.capacity)
        slots = window.slots()
        self._pairs.rebuild(window, slots)
        if not state:
            return
        label_of = dict(zip(state["tracks"].tolist(), state["labels"].tolist(), strict=True))
        self._label[slots] = [label_of.get(key, NO_HYPOTHESIS) for key in window.key[slots].tolist()]
        self._born_ns = dict(zip(state["hypotheses"].tolist(), state["born_ns"].tolist(), strict=True))
        self._before = self._membership(window)

    def _fit(self, capacity: int) -> None:
        extra = capacity - len(self._label)
        self._label = np.pad(self._label, (0, extra), constant_values=NO_HYPOTHESIS)

    def _relabel(self, window: Window, current: Slots, labels: NDArray[np.int64]) -> None:
        before = self._label[current]
        dormant = np.setdiff1d(np.flatnonzero(window.used & ~window.ended), current)
        self._label[dormant] = follow(before, labels, self._label[dormant])
        self._label[current] = labels

    def _membership(self, window: Window) -> Membership:
        """Of everyone who is here or may come back."""
        slots = np.flatnonzero(window.used & ~window.ended & (self._label != NO_HYPOTHESIS))
        return Membership(window.key[slots], self._label[slots])

    def _describe(self, window: Window, current: Slots, labels: NDArray[np.int64]) -> list[Hypothesis]:
        velocity = _velocity(window, current)
        position = window.positions[current, window.stop[current] - 1]
        found = []
        for label in np.unique(labels).tolist():
            members = labels == label
            speed = float(np.linalg.norm(velocity[members].mean(axis=0)))
            found.append(
                Hypothesis(
                    id=label,
                    space=self._spec.name,
                    size=int(members.sum()),
                    born_ns=self._born_ns[label],
                    state="moving" if speed > self._v_moving else "undetermined",
                    centroid=position[members].mean(axis=0).tolist(),
                )
            )
        return found


def _velocity(window: Window, slots: Slots) -> Floats:
    """Mean velocity of each trajectory over its last half second, unit/s [n, dim]."""
    last = window.stop[slots] - 1
    newest = window.times[slots, last]
    first = np.clip(locate(window, slots, newest - _VELOCITY_NS), window.start[slots], last)
    seconds = (newest - window.times[slots, first]) * 1e-9
    step = window.positions[slots, last] - window.positions[slots, first]
    return step / np.where(seconds > 0, seconds, 1.0)[:, None]
