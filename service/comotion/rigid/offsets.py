"""Constant offsets between the sources of a space: imperfect extrinsics and clocks.

A body that two sources see moves by the same motion in both, up to a constant rigid transform and a
delay. Bodies are fitted on one source, the reference; for each other source the small rotation,
shift and delay are found that make its trajectories constant in those bodies' frames.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Ints
from .alignment import COLUMNS, equations
from .bodies import Body, fit
from .frames import Frames
from .panel import FEW, speakers
from .tracks import Tracks

# What a careful calibration leaves: rad, share of the scene's extent, s.
_ROTATION = float(np.radians(2.0))
_SHIFT = 0.03
_DELAY = 0.02
# Squared distance from the prior beyond which two groups are not taken for one body, and the mean
# squared residual (in units of the tolerance) beyond which they do not move alike.
_PLAUSIBLE = 30.0
_ALIKE = 3.0
_LEAST_FRAMES = 8
# Columns of (rotation, shift, delay) that exist in 2-D.
_PLANAR = np.array([2, 3, 4, 6])
# In a large scene so many trajectories of a group tell, and every so many of their frames.
_SPEAKERS = 12
_STRIDE = 3

Equations = tuple[Floats, Floats, float, int]
Groups = dict[int, Ints]


@dataclass(frozen=True)
class Offset:
    """x' = R (x - pivot) + pivot + shift at t' = t + delay brings a source to the reference.

    `rotation` (vector, rad), `shift` and `pivot` are float64 [3], `delay` is in s.
    """

    rotation: Floats
    shift: Floats
    pivot: Floats
    delay: float


class Offsets:
    """Offset of every source but the reference; learnt a little at each update."""

    def __init__(self) -> None:
        self.reference: int | None = None
        self.found: dict[int, Offset] = {}
        self._turn = 0

    def correct(self, tracks: Tracks) -> Tracks:
        """The same trajectories as the reference would have seen them."""
        known = [s for s in np.unique(tracks.source).tolist() if s in self.found]
        if not known:
            return tracks
        delay, turn, shift = tracks.delay_ns.copy(), tracks.turn.copy(), tracks.shift.copy()
        for source in known:
            offset, mine = self.found[source], tracks.source == source
            R = Rotation.from_rotvec(offset.rotation).as_matrix()
            delay[mine] = round(offset.delay * 1e9)
            turn[mine] = R
            shift[mine] = offset.pivot + offset.shift - R @ offset.pivot
        return tracks.moved(delay, turn, shift)

    def learn(self, tracks: Tracks, frames: Frames, labels: Ints) -> None:
        """Improve the offsets from corrected trajectories and the bodies they were assigned to."""
        sources, counts = np.unique(tracks.source, return_counts=True)
        if len(sources) < 2:
            return
        if self.reference not in sources:
            self.reference = int(sources[np.argmax(counts)])
        extent, pivot = tracks.extent(), np.median(tracks.newest(), 0)
        asked = sources.tolist()
        if len(frames.owner) > FEW:
            # In a large scene one source after the other learns, a step at each update.
            others = [one for one in asked if one != self.reference]
            self._turn += 1
            asked = [self.reference, others[self._turn % len(others)]]
        told = [(_told(tracks, frames, labels, one), one) for one in asked]
        if len(frames.owner) > FEW:
            frames, told = _excerpt(frames, told)
        groups = next(groups for groups, one in told if one == self.reference)
        bodies = {k: fit(frames, rows) for k, rows in groups.items()}
        for groups, source in told:
            if bodies and source != self.reference:
                self._improve(source, frames, groups, bodies, extent, pivot)

    def _improve(
        self,
        source: int,
        frames: Frames,
        groups: Groups,
        bodies: dict[int, Body],
        extent: float,
        pivot: Floats,
    ) -> None:
        before = self.found.get(source) or Offset(np.zeros(3), np.zeros(3), pivot, 0.0)
        spread = np.array([_ROTATION] * 3 + [_SHIFT * extent] * 3 + [_DELAY])
        prior = np.diag(1 / (spread if frames.dim == 3 else spread[_PLANAR]) ** 2)
        matched = [_match(frames, rows, k, bodies, before.pivot, prior) for k, rows in sorted(groups.items())]
        step = _solve([one for one in matched if one is not None], prior)
        if step is None:
            return
        full = step
        if frames.dim == 2:
            full = np.zeros(7)
            full[_PLANAR] = step
        turn = Rotation.from_rotvec(full[:3])
        self.found[source] = replace(
            before,
            rotation=(turn * Rotation.from_rotvec(before.rotation)).as_rotvec(),
            shift=turn.apply(before.shift) + full[3:6],
            # y(t + delay) ~ y + ydot delay: what the fit adds to y, the stamps lose.
            delay=before.delay - float(full[6]),
        )

    def state(self) -> dict[str, Any]:
        """As plain values and arrays."""
        return {
            "reference": self.reference,
            "found": [[s, o.rotation, o.shift, o.pivot, o.delay] for s, o in self.found.items()],
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self.reference = state["reference"]
        self.found = {int(s): Offset(r, x, p, float(d)) for s, r, x, p, d in state["found"]}


def _told(tracks: Tracks, frames: Frames, labels: Ints, source: int) -> Groups:
    """Rows of each moving body's trajectories that one source saw, where they are enough for a pose."""
    found = {}
    for k in range(1, int(labels.max(initial=0)) + 1):
        members = (labels == k) & (tracks.source == source) & (frames.life >= _LEAST_FRAMES)
        if members.sum() >= frames.dim:
            if len(frames.owner) > FEW:
                members = speakers(frames, tracks.newest(), members, _SPEAKERS)
            found[k] = frames.rows_of(members)
    return found


def _excerpt(frames: Frames, told: list[tuple[Groups, int]]) -> tuple[Frames, list[tuple[Groups, int]]]:
    """Every so many frames of the rows that tell, and those rows there."""
    rows = np.unique(np.concatenate([np.zeros(0, np.intp), *(r for g, _ in told for r in g.values())]))
    tracks = np.unique(frames.owner[rows])
    all_rows = frames.rows_of(tracks)
    few = frames.of(tracks).thinned(_STRIDE)
    return few, [({k: np.searchsorted(all_rows, r) for k, r in g.items()}, one) for g, one in told]


def _match(
    frames: Frames, rows: Ints, own: int, bodies: dict[int, Body], pivot: Floats, prior: Floats
) -> Equations | None:
    """Equations of rows and the body that explains them: that of their own hypothesis, else the best."""
    first = [_best([_summed(frames, rows, bodies[own], pivot)], prior)] if own in bodies else [None]
    if first[0] is not None:
        return first[0]
    others = [body for k, body in bodies.items() if k != own]
    return _best([_summed(frames, rows, body, pivot) for body in others], prior)


def _summed(frames: Frames, rows: Ints, body: Body, pivot: Floats) -> Equations | None:
    """Normal equations of rows against one body: left, right, residual, count."""
    left, right = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS)
    seconds = (frames.stamps - frames.stamps[0]) * 1e-9
    squared, count = equations(
        frames.y,
        frames.w,
        seconds,
        frames.tolerance,
        rows,
        body.R,
        body.t,
        body.posed,
        pivot,
        _LEAST_FRAMES,
        left,
        right,
    )
    if not count:
        return None
    if frames.dim == 2:
        left, right = left[np.ix_(_PLANAR, _PLANAR)], right[_PLANAR]
    return left, right, squared, count * frames.dim


def _solve(matched: list[Equations], prior: Floats) -> Floats | None:
    """One fit for all groups."""
    if not matched:
        return None
    left = prior + np.sum([one[0] for one in matched], 0)
    return np.asarray(np.linalg.solve(left, np.sum([one[1] for one in matched], 0)), np.float64)


def _best(table: list[Equations | None], prior: Floats) -> Equations | None:
    """The equations of what moves alike, under its own fit."""
    chosen, lowest = None, _ALIKE
    for one in table:
        if one is None:
            continue
        left, right, squared, count = one
        step = np.linalg.solve(left + prior, right)
        remaining = float(squared - 2 * step @ right + step @ left @ step) / count
        if remaining < lowest and float(step @ prior @ step) < _PLAUSIBLE:
            chosen, lowest = one, remaining
    return chosen
