"""In trajectories of several sources, out one space for all (step 2): corrects extrinsics and clocks.

A body that two sources see moves by the same motion in both, up to a constant rigid transform and a
delay. Bodies are fitted to one source, the reference. For each other source we find the small rotation,
shift and delay that make its trajectories constant in the frames of those bodies.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Ints
from .kernels.registration import COLUMNS, normal_equations
from .procrustes import Body, fit_body
from .resampling import Frames
from .subset import SUBSET_ROWS, representatives
from .tracks import Tracks

# Prior standard deviations, what a careful calibration leaves: rad, share of the scene's extent, s.
_ROTATION = float(np.radians(2.0))
_SHIFT = 0.03
_DELAY = 0.02
# Squared distance of a step from the prior beyond which two groups are not taken for one body, and mean
# squared residual after it, in tolerances, beyond which they do not move alike. Chosen on the scenes of
# docs/research/accuracy.md.
_MOST_STEP = 30.0
_MOST_RESIDUAL = 3.0
# A trajectory takes part if it is observed in so many frames.
_LEAST_FRAMES = 8
# Unknowns of (rotation, shift, delay) that exist in 2-D.
_PLANAR = np.array([2, 3, 4, 6])
# In a large scene so many trajectories of a group take part, and every so many of their frames. This bounds
# the work of an update; chosen on made-up crowds of thousands of features.
_REPRESENTATIVES = 12
_STRIDE = 3

Groups = dict[int, Ints]
"""Rows of one source by the label of their body."""


@dataclass(frozen=True)
class Offset:
    """x' = R (x - pivot) + pivot + shift at t' = t + delay brings a source to the reference.

    `rotation` (vector, rad), `shift` and `pivot` are float64 [3], `delay` is in s.
    """

    rotation: Floats
    shift: Floats
    pivot: Floats
    delay: float


@dataclass(frozen=True)
class _Equations:
    """Normal equations left x = right of a step x, the squared residual before it, and the coordinates."""

    left: Floats
    right: Floats
    squared: float
    count: int


class Registration:
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
        """Improve the offsets by corrected trajectories and the bodies they were assigned to.

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
        large = len(frames.owner) > SUBSET_ROWS
        groups = {s: _moving_groups(tracks, frames, labels, s) for s in self._due(sources.tolist(), large)}
        if large:
            frames, groups = _excerpt(frames, groups)
        bodies = {k: fit_body(frames, rows) for k, rows in groups[self.reference].items()}
        extent, pivot = tracks.extent(), np.median(tracks.newest, 0)
        for source, mine in groups.items():
            if bodies and source != self.reference:
                before = self.found.get(source) or Offset(np.zeros(3), np.zeros(3), pivot, 0.0)
                step = _step(frames, mine, bodies, before.pivot, _prior(frames.dim, extent))
                if step is not None:
                    self.found[source] = _improved(before, step)

    def _due(self, sources: list[int], large: bool) -> list[int]:
        """Sources that take part in this update: in a large scene the reference and one other, in turn."""
        if not large:
            return sources
        others = [one for one in sources if one != self.reference]
        self._turn += 1
        return [one for one in sources if one in (self.reference, others[self._turn % len(others)])]

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


def _prior(dim: int, extent: float) -> Floats:
    """Inverse covariance of a step, [7, 7], or [4, 4] in 2-D."""
    spread = np.array([_ROTATION] * 3 + [_SHIFT * extent] * 3 + [_DELAY])
    return np.diag(1 / (spread if dim == 3 else spread[_PLANAR]) ** 2)


def _moving_groups(tracks: Tracks, frames: Frames, labels: Ints, source: int) -> Groups:
    """Rows of one source on each moving body, where they are enough for a pose."""
    found = {}
    for k in range(1, int(labels.max(initial=0)) + 1):
        members = (labels == k) & (tracks.source == source) & (frames.life >= _LEAST_FRAMES)
        if members.sum() >= frames.dim:
            large = len(frames.owner) > SUBSET_ROWS
            some = representatives(frames, tracks.newest, members, _REPRESENTATIVES) if large else members
            found[k] = frames.rows_of(some)
    return found


def _excerpt(frames: Frames, groups: dict[int, Groups]) -> tuple[Frames, dict[int, Groups]]:
    """Thinned frames of the rows that take part only, and the groups by their rows there."""
    rows = np.unique(
        np.concatenate([np.zeros(0, np.intp), *(r for g in groups.values() for r in g.values())])
    )
    tracks = np.unique(frames.owner[rows])
    kept = frames.rows_of(tracks)
    found = {s: {k: np.searchsorted(kept, r) for k, r in g.items()} for s, g in groups.items()}
    return frames.of(tracks).thinned(_STRIDE), found


def _step(
    frames: Frames, groups: Groups, bodies: dict[int, Body], pivot: Floats, prior: Floats
) -> Floats | None:
    """Rotation, shift and delay that bring the groups of a source to the bodies, [7], if any match."""
    matched = [_match(frames, rows, k, bodies, pivot, prior) for k, rows in sorted(groups.items())]
    equations = [one for one in matched if one is not None]
    if not equations:
        return None
    left = prior + np.sum([one.left for one in equations], 0)
    step = np.linalg.solve(left, np.sum([one.right for one in equations], 0))
    if frames.dim == 3:
        return np.asarray(step, np.float64)
    full = np.zeros(COLUMNS)
    full[_PLANAR] = step
    return full


def _improved(before: Offset, step: Floats) -> Offset:
    """An offset after a step [7]."""
    turn = Rotation.from_rotvec(step[:3])
    return replace(
        before,
        rotation=(turn * Rotation.from_rotvec(before.rotation)).as_rotvec(),
        shift=turn.apply(before.shift) + step[3:6],
        # y(t + delay) ~ y + ydot delay: what the fit adds to y, the times lose.
        delay=before.delay - float(step[6]),
    )


def _match(
    frames: Frames, rows: Ints, own: int, bodies: dict[int, Body], pivot: Floats, prior: Floats
) -> _Equations | None:
    """Equations of rows and the body they move with: that of their own hypothesis, else the best other."""
    if own in bodies:
        first = _best([_equations(frames, rows, bodies[own], pivot)], prior)
        if first is not None:
            return first
    others = [body for k, body in bodies.items() if k != own]
    return _best([_equations(frames, rows, body, pivot) for body in others], prior)


def _equations(frames: Frames, rows: Ints, body: Body, pivot: Floats) -> _Equations | None:
    """Equations of rows and one body; None where they share no frames."""
    left, right = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS)
    seconds = (frames.stamps - frames.stamps[0]) * 1e-9
    terms = frames.arrays, seconds, rows, body.poses, pivot, _LEAST_FRAMES
    squared, count = normal_equations(*terms, left, right)
    if not count:
        return None
    if frames.dim == 2:
        left, right = left[np.ix_(_PLANAR, _PLANAR)], right[_PLANAR]
    return _Equations(left, right, squared, count * frames.dim)


def _best(candidates: list[_Equations | None], prior: Floats) -> _Equations | None:
    """The equations with the least residual after their own step; None where none fits well enough."""
    chosen, lowest = None, _MOST_RESIDUAL
    for one in candidates:
        if one is None:
            continue
        step = np.linalg.solve(one.left + prior, one.right)
        remaining = float(one.squared - 2 * step @ one.right + step @ one.left @ step) / one.count
        if remaining < lowest and float(step @ prior @ step) < _MOST_STEP:
            chosen, lowest = one, remaining
    return chosen
