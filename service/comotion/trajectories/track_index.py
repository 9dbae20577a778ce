"""Finds the slots of trajectories in a window by the ids of their features."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Slots
from .window import Window

Ids = NDArray[np.uint64]

# So few ids are looked up one by one; more are searched in one go.
_FEW = 64
# Ids that a session has declared lost and that are remembered, the newest: those of some generations.
MAX_ENDED = 10_000
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
        # Ids that each session has declared lost, oldest first.
        self._ended: dict[int, Ids] = {}
        self.ids: Ids = np.zeros(0, np.uint64)

    def find(self, ids: Ids, session: int) -> Slots:
        """Slots of the ids of a session, intp [n]; -1 where there is none."""
        slots = self._find_again(ids, session)
        missing = np.flatnonzero(slots < 0)
        if len(missing) > _FEW:
            slots[missing] = self._search(ids[missing], session)
        else:
            for k in missing.tolist():
                slots[k] = self._slot_of.get((session, int(ids[k])), -1)
        return slots

    def _search(self, ids: Ids, session: int) -> Slots:
        """As :meth:`find`, for many ids at once."""
        mine = np.flatnonzero(self._window.used & (self._window.source == session))
        if not len(mine):
            return np.full(len(ids), -1)
        mine = mine[np.argsort(self.ids[mine])]
        known = self.ids[mine]
        at = np.minimum(np.searchsorted(known, ids), len(mine) - 1)
        return np.where(known[at] == ids, mine[at], -1)

    def knows(self, session: int) -> bool:
        """Whether a session has sent anything."""
        return session in self._last_sent

    def has_ended(self, ids: Ids, session: int) -> Bools:
        """Which of the ids a session has declared lost for good, bool [n]."""
        ended = self._ended.get(session)
        return np.zeros(len(ids), np.bool_) if ended is None else np.isin(ids, ended)

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
        # Those refused are not kept: a batch may have any number of them.
        known = slots >= 0
        self._last_sent[session] = (ids.copy(), slots) if known.all() else (ids[known], slots[known])

    def close(self, slots: Slots) -> None:
        """Forget trajectories and free their slots."""
        for slot in slots.tolist():
            del self._slot_of[int(self._window.source[slot]), int(self.ids[slot])]
        self._window.close(slots)

    def end(self, ids: Ids, session: int) -> None:
        """Mark trajectories as ended for good, also those that have not been seen yet."""
        ids = ids[-MAX_ENDED:]
        slots = self.find(ids, session)
        self._window.ended[slots[slots >= 0]] = True
        ended = self._ended.get(session, ids[:0])
        self._ended[session] = np.concatenate([ended, ids[~np.isin(ids, ended)]])[-MAX_ENDED:]

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session as ended for good."""
        self._window.ended |= self._window.used & (self._window.source == session)
        self._last_sent.pop(session, None)
        self._ended.pop(session, None)

    def ended(self) -> list[tuple[int, Ids]]:
        """Ids that each session has declared lost."""
        return list(self._ended.items())

    def load(self, ids: Ids, slots: Slots, ended: Iterable[tuple[int, Ids]]) -> None:
        """Take up the ids of the slots in use, of a window that has been filled again, and :meth:`ended`."""
        self._ended = {int(session): lost for session, lost in ended}
        self.ids = np.zeros(self._window.capacity, np.uint64)
        self.ids[slots] = ids
        sessions = self._window.source[slots]
        owners = zip(sessions.tolist(), ids.tolist(), strict=True)
        self._slot_of = dict(zip(owners, slots.tolist(), strict=True))
        for session in np.unique(sessions).tolist():
            self._last_sent[session] = ids[sessions == session], slots[sessions == session]

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
