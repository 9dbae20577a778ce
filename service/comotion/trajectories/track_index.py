"""Finds the slots of trajectories in a window by the ids of their features."""

from collections.abc import Iterable
from itertools import islice

import numpy as np

from ..arrays import Bools, Slots, find
from .window import Ids, Window

# Most lost ids that are remembered of a session, the newest: those of some generations.
MAX_ENDED = 10_000


class TrackIndex:
    """Which slot of a window holds which feature: a trajectory is (session number, id).

    Parameters
    ----------
    window
        The window that holds the trajectories.
    """

    def __init__(self, window: Window) -> None:
        self._window = window
        # Of each session that has sent anything: its ids, ascending, and their slots; None: to be sorted.
        self._sorted: dict[int, tuple[Ids, Slots] | None] = {}
        # Ids that each session has declared lost, oldest first.
        self._ended: dict[int, dict[int, None]] = {}

    def find(self, ids: Ids, session: int) -> Slots:
        """Slots of the ids of a session, intp [n]; -1 where there is none."""
        entry = self._sorted.get(session)
        if entry is None:
            own_slots = np.flatnonzero(self._window.used & (self._window.source == session))
            own_slots = own_slots[np.argsort(self._window.id[own_slots])]
            entry = self._sorted[session] = self._window.id[own_slots], own_slots
        sorted_ids, slots = entry
        return np.append(slots, -1)[find(ids, sorted_ids)]

    def knows(self, session: int) -> bool:
        """Whether a session has sent anything."""
        return session in self._sorted

    def has_ended(self, ids: Ids, session: int) -> Bools:
        """Which of the ids a session has declared lost for good, bool [n]."""
        ended = self._ended.get(session, {})
        return np.array([feature in ended for feature in ids.tolist()], np.bool_)

    def open(self, ids: Ids, session: int) -> Slots:
        """Open a trajectory for each of the ids, which have none; returns their slots, intp [n]."""
        slots = self._window.open(len(ids), session)
        self._window.id[slots] = ids
        self._sorted[session] = None
        return slots

    def close(self, slots: Slots) -> None:
        """Forget trajectories and free their slots."""
        for session in np.unique(self._window.source[slots]).tolist():
            if session in self._sorted:
                self._sorted[session] = None
        self._window.close(slots)

    def end(self, ids: Ids, session: int) -> None:
        """Mark trajectories as ended for good, also those that have not been seen yet."""
        ids = ids[-MAX_ENDED:]
        slots = self.find(ids, session)
        self._window.ended[slots[slots >= 0]] = True
        ended = self._ended.setdefault(session, {})
        ended |= dict.fromkeys(ids.tolist())
        for feature in list(islice(ended, max(len(ended) - MAX_ENDED, 0))):
            del ended[feature]

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session as ended for good."""
        self._window.ended |= self._window.used & (self._window.source == session)
        self._sorted.pop(session, None)
        self._ended.pop(session, None)

    def ended(self) -> list[tuple[int, Ids]]:
        """Ids that each session has declared lost."""
        return [(session, np.array(list(ids), np.uint64)) for session, ids in self._ended.items()]

    def load(self, slots: Slots, ended: Iterable[tuple[int, Ids]]) -> None:
        """Take up the slots in use of a window that has been filled again, and :meth:`ended`."""
        self._ended = {int(session): dict.fromkeys(lost.tolist()) for session, lost in ended}
        self._sorted = dict.fromkeys(np.unique(self._window.source[slots]).tolist())
