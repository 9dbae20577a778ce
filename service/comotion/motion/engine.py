"""The default method (``method = "comotion"``): a hypothesis is a rigid body with a motion.

tracks -> offsets between sources -> frames (noise, tolerance) -> proposals (distance variance)
       -> bodies (rigid motion) -> selection -> assignment -> identity -> kinematics
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..config import FusionConfig
from ..engine import NO_HYPOTHESIS, IdAllocator, Partition, Rows, SpaceSpec
from ..events import Membership, changes
from ..window import Slots, Window
from .confidence import posterior, same_body
from .describe import Describer
from .frames import Frames, make_frames
from .identity import match
from .offsets import Offsets
from .poses import Poses, poses_of
from .search import Found, Past, search
from .tracks import Tracks, gather


class MotionEngine:
    """Engine of one space in a metric (or any Euclidean) unit.

    Parameters
    ----------
    config
        `motion` and `window` matter here.
    spec
        The space.
    ids
        Where new hypotheses get their ids.
    """

    def __init__(self, config: FusionConfig, spec: SpaceSpec, ids: IdAllocator) -> None:
        self._config = config.motion
        self._ids = ids
        self._label: dict[int, int] = {}
        self._strange: dict[int, float] = {}
        self._static: int | None = None
        self._offsets = Offsets()
        self._describer = Describer(spec.name, config.motion)
        self._before = Membership.empty()
        self._affinity: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._last: tuple[Tracks, Frames, Found, NDArray[np.int64]] | None = None

    def observed(self, window: Window, rows: Rows) -> None:
        """Nothing to do: the window is read at updates."""

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Nothing to do."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Labels of forgotten trajectories go."""
        for key in window.key[slots].tolist():
            self._label.pop(key, None)

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories."""
        tracks = gather(window, current, stamp_ns)
        if not len(tracks.key):
            return self._nothing(window, stamp_ns)
        lag = self._offsets.lag_ns(tracks)
        tracks = self._offsets.correct(tracks)
        frames = make_frames(tracks, stamp_ns, window.span_ns, window.gap_ns, lag, self._config)
        before = np.array([self._label.get(k, NO_HYPOTHESIS) for k in tracks.key.tolist()], np.int64)
        strange = np.array([self._strange.get(k, 0.0) for k in tracks.key.tolist()])
        found = search(frames, tracks.newest(), Past(before, self._static, strange), self._config)
        self._strange = dict(zip(tracks.key.tolist(), found.strange.tolist(), strict=True))
        columns = found.assignment.labels
        ids = self._name(columns, before, len(found.bodies))
        labels = np.where(columns >= 0, ids[columns], NO_HYPOTHESIS)
        self._static = int(ids[0]) if ids[0] != NO_HYPOTHESIS else None
        self._label = dict(zip(tracks.key.tolist(), labels.tolist(), strict=True))
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before = after
        self._last = (tracks, frames, found, ids)
        hypotheses = self._describer.describe(tracks, frames, found, ids)
        self._offsets.learn(tracks, frames, columns)
        chosen = np.searchsorted(tracks.key, window.key[current])
        chances = posterior(found.assignment)[chosen]
        self._affinity = same_body(chances)
        confidence = chances[np.arange(len(chosen)), columns[chosen] + 1]
        return Partition(labels[chosen], confidence, hypotheses, events)

    def affinity(self) -> NDArray[np.float32]:
        """Probability that two trajectories belong to one body, [n, n] of the last update."""
        return self._affinity

    def poses(self) -> Poses | None:
        """Bodies and their poses over the window as of the last update; None where there was nothing."""
        return None if self._last is None else poses_of(*self._last)

    def state(self, window: Window) -> dict[str, Any]:
        """Labels of all trajectories, the hypotheses' births and poses, and the sources' offsets."""
        del window
        return {
            "tracks": np.array(list(self._label), np.int64),
            "labels": np.array(list(self._label.values()), np.int64),
            "static": self._static,
            "offsets": self._offsets.state(),
            "anchors": self._describer.state(),
        }

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; all else is read from the window."""
        if not state:
            return
        self._label = dict(zip(state["tracks"].tolist(), state["labels"].tolist(), strict=True))
        self._static = state["static"]
        self._offsets.load(state["offsets"])
        self._describer.load(state["anchors"])
        self._before = self._membership(window)

    def _nothing(self, window: Window, stamp_ns: int) -> Partition:
        self._label, self._last = {}, None
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before, self._affinity = after, np.zeros((0, 0), np.float32)
        return Partition(np.zeros(0, np.int64), np.zeros(0), [], events)

    def _name(self, columns: NDArray[np.intp], before: NDArray[np.int64], bodies: int) -> NDArray[np.int64]:
        """Id of each body [K]; :data:`NO_HYPOTHESIS` for one without members."""
        ids = np.full(bodies, NO_HYPOTHESIS)
        matched = match(columns, before, bodies)
        for k in np.unique(columns[columns >= 0]).tolist():
            ids[k] = matched[k] if k in matched else self._ids.next()
        return ids

    def _membership(self, window: Window) -> Membership:
        """Of everyone who is here or may come back."""
        slots = window.slots()
        slots = slots[~window.ended[slots]]
        labels = np.array([self._label.get(k, NO_HYPOTHESIS) for k in window.key[slots].tolist()], np.int64)
        known = labels != NO_HYPOTHESIS
        return Membership(window.key[slots][known], labels[known])
