"""Trails: positions of features over time -> one segment per feature and step. Pure.

Only the newest position of every current feature is stored. The viewer decides how many past segments it
shows.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .drawing import Positions

Ids: TypeAlias = NDArray[np.uint64]
LONGEST_GAP_NS = 1_000_000_000
"""A feature that was missing for longer starts a new trail."""


class Trails:
    """The trails of one set of features, e.g. of one source in one space."""

    def __init__(self) -> None:
        self._last: tuple[object, int, Ids, Positions] | None = None

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
        old_ids, old_places = ids[:0], positions[:0]
        if self._last is not None and self._last[0] == key and 0 < stamp_ns - self._last[1] <= LONGEST_GAP_NS:
            _, _, old_ids, old_places = self._last
        self._last = key, stamp_ns, ids, positions
        _, rows, old = np.intersect1d(ids, old_ids, assume_unique=True, return_indices=True)
        return rows, np.stack([old_places[old], positions[rows]], axis=1)
