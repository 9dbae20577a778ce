"""The default method (``method = "comotion"``): a hypothesis is a rigid body with a motion.

tracks -> offsets between sources -> frames (noise, tolerance) -> panel -> proposals (distance variance)
       -> bodies (rigid motion) -> selection -> assignment -> identity -> kinematics
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Slots, Stamps
from ..config import FusionConfig
from ..hypotheses.events import Membership, changes
from ..partition import NO_HYPOTHESIS, IdAllocator, Partition, Rows, SpaceSpec
from ..trajectories.window import Window
from .confidence import posterior, same_body
from .describe import Describer
from .frames import Frames, make_frames
from .identity import match
from .noise import Differences
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
        # Of all trajectories of the last update, by key, ascending.
        self._keys: Stamps = np.zeros(0, np.int64)
        self._labels: NDArray[np.int64] = np.zeros(0, np.int64)
        self._strange: Floats = np.zeros(0)
        self._static: int | None = None
        self._offsets = Offsets()
        self._differences = Differences()
        self._describer = Describer(spec.name, config.motion)
        self._before = Membership.empty()
        self._chances: Floats = np.zeros((0, 1))
        self._last: tuple[Tracks, Frames, Found, NDArray[np.int64]] | None = None

    def observed(self, window: Window, rows: Rows) -> None:
        """The window is read at updates; only what was known of late rows is void."""
        del window
        if not rows.in_order:
            self._differences.rewritten(rows.slots)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Nothing to do."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Nothing to do: keys are never used again, and labels are those of the last update."""

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories."""
        tracks = gather(window, current, stamp_ns)
        if not len(tracks.key):
            return self._nothing(window, stamp_ns)
        tracks = self._offsets.correct(tracks)
        spans = window.span_ns, window.gap_ns
        frames = make_frames(tracks, self._differences, stamp_ns, *spans, self._config)
        before, strange = self._remembered(tracks.key)
        found = search(frames, tracks.newest(), Past(before, self._static, strange), self._config)
        columns = found.assignment.labels
        ids = self._name(columns, before, len(found.bodies))
        labels = np.where(columns >= 0, ids[columns], NO_HYPOTHESIS)
        self._static = int(ids[0]) if ids[0] != NO_HYPOTHESIS else None
        self._keys, self._labels, self._strange = tracks.key, labels, found.strange
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before = after
        self._last = (tracks, frames, found, ids)
        hypotheses = self._describer.describe(tracks, frames, found, ids)
        self._offsets.learn(tracks, frames, columns)
        chosen = np.searchsorted(tracks.key, window.key[current])
        self._chances = chances = posterior(found.assignment)[chosen]
        confidence = chances[np.arange(len(chosen)), columns[chosen] + 1]
        return Partition(labels[chosen], confidence, hypotheses, events)

    def affinity(self) -> NDArray[np.float32]:
        """Probability that two trajectories belong to one body, [n, n] of the last update."""
        return same_body(self._chances)

    def poses(self) -> Poses | None:
        """Bodies and their poses over the window as of the last update; None where there was nothing."""
        return None if self._last is None else poses_of(*self._last)

    def state(self, window: Window) -> dict[str, Any]:
        """Labels of all trajectories, the hypotheses' births and poses, and the sources' offsets."""
        del window
        return {
            "tracks": self._keys,
            "labels": self._labels,
            "static": self._static,
            "offsets": self._offsets.state(),
            "anchors": self._describer.state(),
        }

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; all else is read from the window."""
        if not state:
            return
        self._keys, self._labels = state["tracks"], state["labels"]
        self._strange = np.zeros(len(self._keys))
        self._static = state["static"]
        self._offsets.load(state["offsets"])
        self._describer.load(state["anchors"])
        self._before = self._membership(window)

    def _nothing(self, window: Window, stamp_ns: int) -> Partition:
        self._keys, self._labels, self._strange = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        self._last = None
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before, self._chances = after, np.zeros((0, 1))
        return Partition(np.zeros(0, np.int64), np.zeros(0), [], events)

    def _remembered(self, keys: Stamps) -> tuple[NDArray[np.int64], Floats]:
        """Label and strangeness of trajectories at the last update, [n] each."""
        labels, strange = np.full(len(keys), NO_HYPOTHESIS), np.zeros(len(keys))
        if len(self._keys):
            at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
            known = self._keys[at] == keys
            labels[known], strange[known] = self._labels[at[known]], self._strange[at[known]]
        return labels, strange

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
        labels, _ = self._remembered(window.key[slots])
        known = labels != NO_HYPOTHESIS
        return Membership(window.key[slots][known], labels[known])
