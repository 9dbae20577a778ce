"""Registers the sources of a space (step 2): corrects their extrinsics and clocks.

A body that two sources see moves by the same motion in both, up to a constant rigid transform and a
delay. Bodies are fitted to one source, the reference. For each other source, :mod:`.explanations` finds the
small rotation, shift and delay that make its trajectories constant in the frames of those bodies.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import Ints
from ..geometry.body import fit_body
from ..geometry.frames import LONG_LIFE, Frames
from ..geometry.procrustes import SOFT
from .explanations import Groups, Offset, View, explained
from .subset import MOST_OF_EACH, is_small, representatives
from .tracks import Tracks


class Registration:
    """Offset of every source but the reference; estimated anew from the window after each fit."""

    def __init__(self) -> None:
        self.reference: int | None = None
        self.offsets: dict[int, Offset] = {}

    def correct(self, tracks: Tracks) -> Tracks:
        """The same trajectories, which have no corrections yet, as the reference would have seen them."""
        sources = [s for s in np.unique(tracks.source).tolist() if s in self.offsets]
        if not sources:
            return tracks
        delay, turn, shift = tracks.delay_ns.copy(), tracks.turn.copy(), tracks.shift.copy()
        for source in sources:
            offset, members = self.offsets[source], tracks.source == source
            delay[members] = round(offset.delay * 1e9)
            turn[members], shift[members] = offset.transform()
        newest = np.einsum("nij,nj->ni", turn, tracks.newest) + shift
        return replace(tracks, delay_ns=delay, turn=turn, shift=shift, newest=newest)

    def learn(self, tracks: Tracks, frames: Frames, labels: Ints) -> None:
        """Estimate the offsets by corrected trajectories and the bodies they were assigned to.

        Parameters
        ----------
        labels
            intp [N], body of each trajectory: 0 for the static one, below 0 for an outlier.
        """
        sources, counts = np.unique(tracks.source, return_counts=True)
        if len(sources) < 2:
            return
        if self.reference is None or self.reference not in sources:
            self.reference = int(sources[np.argmax(counts)])
        groups = {s: _moving_groups(tracks, frames, labels, s) for s in sources.tolist()}
        bodies = {k: fit_body(frames, rows) for k, rows in groups[self.reference].items()}
        pivot = np.median(tracks.newest, 0)
        for source, source_groups in groups.items():
            if bodies and source_groups and source != self.reference:
                applied = self.offsets.get(source) or Offset.none(pivot)
                offset = explained(View(frames, source_groups, bodies), applied)
                self.offsets.pop(source, None)
                if offset.vector.any():
                    self.offsets[source] = offset

    def state(self) -> dict[str, Any]:
        """As plain values and arrays."""
        return {
            "reference": self.reference,
            "found": [[s, o.rotation, o.shift, o.pivot, o.delay] for s, o in self.offsets.items()],
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self.reference = state["reference"]
        self.offsets = {int(s): Offset(r, x, p, float(d)) for s, r, x, p, d in state["found"]}


def _moving_groups(tracks: Tracks, frames: Frames, labels: Ints, source: int) -> Groups:
    """Rows of one source on each moving body: enough for a pose, that move by three times their noise."""
    groups = {}
    for k in range(1, int(labels.max(initial=0)) + 1):
        members = (labels == k) & (tracks.source == source) & (frames.life >= LONG_LIFE)
        if members.sum() >= frames.dim:
            if not is_small(frames):
                members = representatives(frames, tracks.newest, members, MOST_OF_EACH)
            rows = frames.rows_of(members)
            # The poses of a body at rest are noise, which would look like motion that constrains an offset.
            if np.mean(frames.moved[rows] / frames.tolerance[rows]) > SOFT:
                groups[k] = rows
    return groups
