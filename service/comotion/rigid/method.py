"""The default method (``method = "comotion"``): a hypothesis is a rigid body with a motion.

tracks -> offsets between sources -> frames (noise, tolerance) -> panel -> proposals (distance variance)
       -> bodies (rigid motion) -> selection -> assignment -> motions
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Labels, Slots, Stamps
from ..config import FusionConfig
from ..matching import largest_total
from ..partition import NO_HYPOTHESIS, Partition, Previous, Rows, SpaceSpec
from ..trajectories.window import Window
from .confidence import posterior, same_body
from .frames import Frames, make_frames
from .motions import describe_bodies
from .noise import Differences
from .offsets import Offsets
from .poses import Poses, poses_of
from .search import Found, Past, search
from .tracks import Tracks, gather


class RigidMethod:
    """The rigid-motion method for one space in a metric (or any Euclidean) unit.

    Parameters
    ----------
    config
        `rigid` and `window` matter here.
    spec
        The space.
    """

    matching = staticmethod(largest_total)

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:
        self._config = config.rigid
        self._dim = spec.dim
        # Of all trajectories of the last update, by key, ascending.
        self._keys: Stamps = np.zeros(0, np.int64)
        self._strange: Floats = np.zeros(0)
        self._offsets = Offsets()
        self._differences = Differences()
        self._chances: Floats = np.zeros((0, 1))
        self._last: tuple[Tracks, Frames, Found] | None = None

    def observed(self, window: Window, rows: Rows) -> None:
        """The window is read at updates; only what was known of late rows is void."""
        del window
        if not rows.in_order:
            self._differences.rewritten(rows.slots)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Nothing to do."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Nothing to do: keys are never used again."""

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories."""
        tracks = gather(window, current, stamp_ns)
        if not len(tracks.key):
            return self._nothing()
        tracks = self._offsets.correct(tracks)
        spans = window.span_ns, window.gap_ns
        frames = make_frames(tracks, self._differences, stamp_ns, *spans, self._config)
        static = int(previous.ids[0]) if len(previous.ids) and previous.ids[0] != NO_HYPOTHESIS else None
        past = Past(previous.labels[tracks.slot], static, self._remembered(tracks.key))
        found = search(frames, tracks.newest(), past, self._config)
        groups = found.assignment.labels
        self._keys, self._strange = tracks.key, found.strange
        self._last = (tracks, frames, found)
        described = describe_bodies(tracks, frames, found, self._config)
        self._offsets.learn(tracks, frames, groups)
        chosen = np.searchsorted(tracks.key, window.key[current])
        self._chances = chances = posterior(found.assignment)[chosen]
        confidence = chances[np.arange(len(chosen)), groups[chosen] + 1]
        position = tracks.newest()[chosen, : self._dim]
        deciding = np.ones(len(groups), np.bool_)
        return Partition(tracks.slot, groups, deciding, confidence, position, described)

    def affinity(self) -> NDArray[np.float32]:
        """Probability that two trajectories belong to one body, [n, n] of the last update."""
        return same_body(self._chances)

    def poses(self, ids: Labels) -> Poses | None:
        """Bodies and their poses over the window as of the last update; None where there was nothing.

        `ids` int64 [K] are the hypotheses of the last partition's groups.
        """
        return None if self._last is None else poses_of(*self._last, ids)

    def state(self) -> dict[str, Any]:
        """The sources' offsets."""
        return {"offsets": self._offsets.state()}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; all else is read from the window."""
        del window
        if state:
            self._offsets.load(state["offsets"])

    def _nothing(self) -> Partition:
        self._keys, self._strange = np.zeros(0, np.int64), np.zeros(0)
        self._last, self._chances = None, np.zeros((0, 1))
        nobody = np.zeros(0, np.intp)
        return Partition(nobody, nobody, np.zeros(0, np.bool_), np.zeros(0), np.zeros((0, self._dim)))

    def _remembered(self, keys: Stamps) -> Floats:
        """Strangeness of trajectories at the last update, float64 [N]."""
        strange = np.zeros(len(keys))
        if len(self._keys):
            at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
            known = self._keys[at] == keys
            strange[known] = self._strange[at[known]]
        return strange
