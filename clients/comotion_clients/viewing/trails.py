"""Where features have come from: one segment per feature and step. Pure.

Only the newest place of every current feature is kept; how far back trails reach is up to whoever
draws the segments.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .shapes import Places

Ids: TypeAlias = NDArray[np.uint64]
LONGEST_GAP_NS = 1_000_000_000
"""A feature that was away for longer starts a new trail."""


class Trails:
    """The trails of one set of features, e.g. those of one source in one space."""

    def __init__(self) -> None:
        self._key: object = None
        self._stamp_ns = 0
        self._ids: Ids = np.empty(0, np.uint64)
        self._places: Places = np.empty((0, 3), np.float32)

    def step(self, key: object, stamp_ns: int, ids: Ids, places: Places) -> tuple[NDArray[np.intp], Places]:
        """Take in the places of now.

        Parameters
        ----------
        key
            Whose ids these are; another key, such as a new session, starts anew.
        stamp_ns
            When.
        ids
            uint64 [N], unique.
        places
            float32 [N, dim].

        Returns
        -------
        The rows [M] that have a segment, and the segments float32 [M, 2, dim] from the last place.
        """
        known = key == self._key and 0 < stamp_ns - self._stamp_ns <= LONGEST_GAP_NS
        rows, before = self._shared(ids) if known else (np.empty(0, np.intp), np.empty(0, np.intp))
        ends = np.stack([self._places[before], places[rows]], axis=1) if len(rows) else _none(places)
        order = np.argsort(ids)
        self._key, self._stamp_ns, self._ids, self._places = key, stamp_ns, ids[order], places[order]
        return rows, ends

    def _shared(self, ids: Ids) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of features seen before, and where they were in the arrays of before."""
        if not len(self._ids):
            return np.empty(0, np.intp), np.empty(0, np.intp)
        at = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
        rows = np.flatnonzero(self._ids[at] == ids)
        return rows, at[rows]


def _none(places: Places) -> Places:
    return np.empty((0, 2, places.shape[1]), np.float32)
