"""Tells by the last seconds which parts of a body are bodies of their own, and which bodies are one.

Over a fraction of a second two bodies that touch move alike: one field explains a gripper and what it holds.
Over seconds they turn against each other, as the grouping of a window shows (:mod:`.grouping`).
"""

import numpy as np

from ..arrays import Ints, nanmedian, thinned
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window
from .grouping import group
from .key_frames import key_frames
from .newborns import nearest_votes
from .recent import Recent

# ns; over which members of a body are compared, and for how long a part must differ; between two looks, and
# most that one counts for.
_SPAN_NS, _EVERY_NS, _MOST_NS = 3_000_000_000, 500_000_000, 1_000_000_000
# Fewest members of a part, most that are compared, and key frames in which one of these is seen.
_LEAST_PART, _MOST_COMPARED, _LEAST_SEEN = 8, 100, 8
# px; a body that has moved less within a second shows nothing. Time scales up to that second.
_LEAST_MOTION_PX, _SCALES = 4.0, 3


class Structure:
    """Follows which bodies consist of parts."""

    def __init__(self) -> None:
        self._looked_ns = 0
        # By body: when it was looked at last, and for how long a part has differed, ns.
        self._seen: dict[int, tuple[int, int]] = {}

    def is_due(self, stamp_ns: int) -> bool:
        """Whether a body is to be looked at."""
        return stamp_ns - self._looked_ns >= _EVERY_NS

    def parted(
        self, window: Window, recent: Recent, bodies: dict[int, Ints], stamp_ns: int
    ) -> tuple[int, Ints] | None:
        """A body, and the rows of its members that are a body of their own; None for most looks.

        One body is looked at, the one whose turn it is.

        Parameters
        ----------
        window, recent
            Store of all trajectories, and n of them.
        bodies
            Rows intp [m] of the members of each body that moves or rests.
        stamp_ns
            The instant.
        """
        self._looked_ns = stamp_ns
        large = {body: rows for body, rows in bodies.items() if len(rows) >= 2 * _LEAST_PART}
        moved = np.where(recent.seen, np.linalg.norm(recent.displacement, axis=2), np.nan)[:_SCALES]
        typical = {body: nanmedian(moved[:, rows], 1) for body, rows in large.items()}
        shown = {body: rows for body, rows in large.items() if (typical[body] >= _LEAST_MOTION_PX).any()}
        if not shown:
            return None
        body = min(shown, key=lambda name: self._seen.get(name, (0, 0))[0])
        last_ns, differs_ns = self._seen.get(body, (0, 0))
        labels = self._pieces(window, recent, shown[body], stamp_ns)
        part = shown[body][labels == np.argsort(-np.bincount(labels, minlength=2), kind="stable")[1]]
        counts_ns = min(stamp_ns - last_ns, _MOST_NS)
        differs_ns = max(differs_ns + (counts_ns if len(part) >= _LEAST_PART else -counts_ns), 0)
        self._seen[body] = stamp_ns, differs_ns
        if differs_ns < _SPAN_NS:
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
        stamps = [stamp for stamp in window.instants if stamp_ns - _SPAN_NS < stamp <= stamp_ns]
        frames = key_frames(window, slots, recent.variance[rows], stamps)
        compared = thinned(np.flatnonzero(frames.visible.sum(axis=0) >= _LEAST_SEEN), _MOST_COMPARED)
        if len(compared) < 2:
            return np.zeros(len(rows), np.intp)
        labels = np.full(len(rows), NO_HYPOTHESIS)
        labels[compared] = group(frames.of(compared), labels[compared])[0]
        votes = nearest_votes(recent.position[rows], labels, int(labels.max()) + 1, np.inf)
        return np.where(labels >= 0, labels, votes.argmax(axis=1))
