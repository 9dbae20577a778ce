"""Ids of features in, the slots of their trajectories in a window out."""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Slots
from .window import Window

Ids = NDArray[np.uint64]

# Where at most one id in 16 differs from those sent last, only these are looked up one by one.
_REPLACED_SHARE = 16


class TrackIndex:
    """Which slot of a window holds which feature: a trajectory is (session number, id).

    Parameters
    ----------
    window
        The window that holds the trajectories.

    Attributes
    ----------
    ids
        uint64 [capacity], id of the feature in each slot in use.
    """

    def __init__(self, window: Window) -> None:
        self._window = window
        self._slot_of: dict[tuple[int, int], int] = {}
        # Ids that each session sent last, and their slots.
        self._last_sent: dict[int, tuple[Ids, Slots]] = {}
        self.ids: Ids = np.zeros(0, np.uint64)

    def find(self, ids: Ids, session: int) -> Slots:
        """Slots of the ids of a session, intp [n]; -1 where there is none."""
        slots = self._find_again(ids, session)
        for k in np.flatnonzero(slots < 0).tolist():
            slots[k] = self._slot_of.get((session, int(ids[k])), -1)
        return slots

    def open(self, ids: Ids, session: int) -> Slots:
        """Open a trajectory for each of the ids, which have none; returns their slots, intp [n]."""
        slots = self._window.open(len(ids), session)
        extra = self._window.capacity - len(self.ids)
        if extra:
            self.ids = np.concatenate([self.ids, np.zeros(extra, np.uint64)])
        self.ids[slots] = ids
        self._slot_of.update(((session, i), int(s)) for i, s in zip(ids.tolist(), slots, strict=True))
        return slots

    def expect(self, ids: Ids, session: int, slots: Slots) -> None:
        """Note what a session sent: most sources send the same ids again."""
        self._last_sent[session] = ids.copy(), slots

    def close(self, slots: Slots) -> None:
        """Forget trajectories and free their slots."""
        for slot in slots.tolist():
            del self._slot_of[int(self._window.source[slot]), int(self.ids[slot])]
        self._window.close(slots)

    def end(self, ids: Ids, session: int) -> None:
        """Mark trajectories as ended for good; ids without a trajectory are ignored."""
        slots = [self._slot_of[session, i] for i in ids.tolist() if (session, i) in self._slot_of]
        self._window.ended[slots] = True

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session as ended for good."""
        self._window.ended |= self._window.used & (self._window.source == session)
        self._last_sent.pop(session, None)

    def load(self, ids: Ids, slots: Slots) -> None:
        """Take up the ids of the slots in use, over a window that has been filled again."""
        self.ids = np.zeros(self._window.capacity, np.uint64)
        self.ids[slots] = ids
        sessions = self._window.source[slots].tolist()
        self._slot_of = dict(zip(zip(sessions, ids.tolist(), strict=True), slots.tolist(), strict=True))

    def _find_again(self, ids: Ids, session: int) -> Slots:
        """Slots of the ids that the session sent last; -1 for the others."""
        sent, slots = self._last_sent.get(session, (ids[:0], np.zeros(0, np.intp)))
        if not len(sent) or not self._window.capacity:
            return np.full(len(ids), -1)
        # Most sources send the same ids in the same order, but for a few that are replaced in their place.
        if len(sent) != len(ids) or np.count_nonzero(sent != ids) > len(ids) // _REPLACED_SHARE:
            order = np.argsort(sent, kind="stable")
            at = order[np.minimum(np.searchsorted(sent, ids, sorter=order), len(sent) - 1)]
            slots = slots[at]
        # A slot may hold another trajectory by now.
        window = self._window
        same = window.used[slots] & (window.source[slots] == session) & (self.ids[slots] == ids)
        return np.where(same & (slots >= 0), slots, -1)
