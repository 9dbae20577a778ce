"""Tells by the last seconds which parts of a body are bodies of their own, and which bodies are one.

Over a fraction of a second two bodies that touch move alike: one field explains a gripper and what it holds.
Over seconds they turn against each other, as the grouping of a window shows (:mod:`.grouping`).
"""

import numpy as np

from ..arrays import Ints, thinned
from ..config import PixelsConfig
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window
from .grouping import group
from .key_frames import frames_since
from .newborns import nearest_votes
from .recent import Recent

# ns; over which the members of a body are compared; time between two looks at one body.
_SPAN_NS, _LOOK_NS = 3_000_000_000, 500_000_000
# Looks with a part, less those without, that tell it from its body: two spans that share no motion.
_LOOKS = 6
# Fewest members of a part, most that are compared, and key frames in which one of these is seen.
_LEAST_PART, _MOST_COMPARED, _LEAST_SEEN = 8, 100, 8
# px; a body that has moved less within a second shows nothing. Time scales up to that second.
_LEAST_MOTION_PX, _SCALES = 4.0, 3


class Structure:
    """Follows which bodies consist of parts."""

    def __init__(self, config: PixelsConfig) -> None:
        self._config = config
        # By body: when it was looked at last, and how much more often a part was seen than not.
        self._seen: dict[int, tuple[int, int]] = {}

    def parted(
        self, window: Window, recent: Recent, bodies: dict[int, Ints], stamp_ns: int
    ) -> tuple[int, Ints] | None:
        """A body, and the rows of its members that are a body of their own; None for most instants.

        One body is looked at each time, the one whose turn it is.

        Parameters
        ----------
        window, recent
            Store of all trajectories, and n of them.
        bodies
            Rows intp [m] of the members of each body that moves or rests.
        stamp_ns
            The instant.
        """
        body = min(bodies, key=lambda name: self._seen.get(name, (0, 0))[0], default=None)
        if body is None:
            return None
        last_ns, count = self._seen.get(body, (0, 0))
        if stamp_ns - last_ns < _LOOK_NS:
            return None
        rows = bodies[body]
        if len(rows) < 2 * _LEAST_PART or recent.farthest(rows, _SCALES) < _LEAST_MOTION_PX:
            self._seen[body] = stamp_ns, count
            return None
        labels = self._pieces(window, recent, rows, stamp_ns)
        sizes = np.bincount(labels)
        part = rows[labels == np.argsort(-sizes, kind="stable")[1]] if len(sizes) > 1 else rows[:0]
        if len(part) < _LEAST_PART:
            self._seen[body] = stamp_ns, max(count - 1, 0)
            return None
        self._seen[body] = stamp_ns, count + 1
        if count + 1 < _LOOKS:
            return None
        self.forget(body)
        return body, part

    def are_one(self, window: Window, recent: Recent, bodies: list[Ints], stamp_ns: int) -> bool:
        """Whether most of the members of bodies, by rows intp [m], are in one piece."""
        labels = self._pieces(window, recent, np.concatenate(bodies), stamp_ns)
        parts = np.split(labels, np.cumsum([len(rows) for rows in bodies])[:-1])
        return len({int(np.bincount(part).argmax()) for part in parts if len(part)}) <= 1

    def forget(self, body: int) -> None:
        """A body is no more, or another one."""
        self._seen.pop(body, None)

    def _pieces(self, window: Window, recent: Recent, rows: Ints, stamp_ns: int) -> Ints:
        """Piece of each row, intp [m]; those that were seen too shortly are where their neighbours are."""
        slots = recent.slots[rows]
        frames = frames_since(window, slots, stamp_ns - _SPAN_NS, stamp_ns, self._config.key_frames)
        compared = thinned(np.flatnonzero(frames.visible.sum(axis=0) >= _LEAST_SEEN), _MOST_COMPARED)
        if len(compared) < 2:
            return np.zeros(len(rows), np.intp)
        labels = np.full(len(rows), NO_HYPOTHESIS)
        none_before = np.full(len(compared), NO_HYPOTHESIS)
        labels[compared] = group(frames.of(compared), self._config, none_before).labels
        votes = nearest_votes(recent.position[rows], labels, int(labels.max()) + 1, np.inf)
        return np.where(labels >= 0, labels, votes.argmax(axis=1))
