"""Trails: positions of features over time -> one segment per feature and step. Pure.

Only the newest position of every current feature is stored. The viewer decides how many past segments it
shows.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .shapes import Positions

Ids: TypeAlias = NDArray[np.uint64]
LONGEST_GAP_NS = 1_000_000_000
"""A feature that was missing for longer starts a new trail."""


class Trails:
    """The trails of one set of features, e.g. of one source in one space."""

    def __init__(self) -> None:
        self._key: object = None
        self._stamp_ns = 0
        self._ids: Ids = np.empty(0, np.uint64)
        self._places: Positions = np.empty((0, 3), np.float32)

    def step(
        self, key: object, stamp_ns: int, ids: Ids, positions: Positions
    ) -> tuple[NDArray[np.intp], Positions]:
        """Add the positions of an instant.

        Parameters
        ----------
        key
            Identifies the set of ids; another key, such as a new session, starts new trails.
        stamp_ns
            Time of the positions; it must increase, else new trails start.
        ids
            uint64 [N], unique.
        positions
            float32 [N, dim].

        Returns
        -------
        Rows intp [M] with a segment, and segments float32 [M, 2, dim] from the last position.
        """
        known = key == self._key and 0 < stamp_ns - self._stamp_ns <= LONGEST_GAP_NS
        rows, before = self._shared(ids) if known else (np.empty(0, np.intp), np.empty(0, np.intp))
        ends = np.stack([self._places[before], positions[rows]], axis=1) if len(rows) else _none(positions)
        order = np.argsort(ids)
        self._key, self._stamp_ns, self._ids, self._places = key, stamp_ns, ids[order], positions[order]
        return rows, ends

    def _shared(self, ids: Ids) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of features that were present before, and their rows in the stored arrays."""
        if not len(self._ids):
            return np.empty(0, np.intp), np.empty(0, np.intp)
        at = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
        rows = np.flatnonzero(self._ids[at] == ids)
        return rows, at[rows]


def _none(positions: Positions) -> Positions:
    return np.empty((0, 2, positions.shape[1]), np.float32)
