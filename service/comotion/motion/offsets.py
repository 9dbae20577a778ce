"""Constant offsets between the sources of a space: imperfect extrinsics and clocks.

A body that two sources see moves by the same motion in both, up to a constant rigid transform and a
delay. Bodies are fitted on one source, the reference; for each other source the small rotation,
shift and delay are found that make its trajectories constant in those bodies' frames.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..window import Floats
from .bodies import Body, fit
from .frames import Frames
from .tracks import Ints, Tracks

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

Equations = tuple[Floats, Floats, float, int]


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
        bodies = [fit(frames, rows) for rows in _groups(tracks, frames, labels, self.reference)]
        if not bodies:
            return
        extent = tracks.extent()
        for source in sources.tolist():
            if source != self.reference:
                groups = _groups(tracks, frames, labels, source)
                self._improve(source, frames, groups, bodies, extent, tracks)

    def _improve(
        self,
        source: int,
        frames: Frames,
        groups: list[Ints],
        bodies: list[Body],
        extent: float,
        tracks: Tracks,
    ) -> None:
        before = self.found.get(source)
        if before is None:
            pivot = np.median(tracks.newest(), 0)
            before = Offset(np.zeros(3), np.zeros(3), pivot, 0.0)
        spread = np.array([_ROTATION] * 3 + [_SHIFT * extent] * 3 + [_DELAY])
        prior = np.diag(1 / (spread if frames.dim == 3 else spread[_PLANAR]) ** 2)
        tables = [[_summed(frames, rows, body, before.pivot) for body in bodies] for rows in groups]
        step = _solve(tables, prior)
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


def _groups(tracks: Tracks, frames: Frames, labels: Ints, source: int | None) -> list[Ints]:
    """Rows of each moving body's trajectories that one source saw, where they are enough for a pose."""
    found = []
    for k in range(1, int(labels.max(initial=0)) + 1):
        members = (labels == k) & (tracks.source == source) & (frames.life >= _LEAST_FRAMES)
        if members.sum() >= frames.dim:
            found.append(frames.rows_of(members))
    return found


def _columns(y: Floats, velocity: Floats, R: Floats, pivot: Floats, dim: int) -> Floats:
    """d(R^T y) by (rotation, shift, delay): R^T [omega x (y - pivot) + shift + velocity delay], [F, 3, p]."""
    r = y - pivot
    world = np.zeros((len(y), 3, 7))
    world[:, 0, 1], world[:, 0, 2] = r[:, 2], -r[:, 1]
    world[:, 1, 0], world[:, 1, 2] = -r[:, 2], r[:, 0]
    world[:, 2, 0], world[:, 2, 1] = r[:, 1], -r[:, 0]
    world[:, :, 3:6] = np.eye(3)
    world[:, :, 6] = velocity
    return np.asarray(np.einsum("fji,fjp->fip", R, world if dim == 3 else world[:, :, _PLANAR]))


def _equations(frames: Frames, row: int, body: Body, pivot: Floats) -> Equations | None:
    """Normal equations of one row against one body: left, right, residual, count."""
    k = np.flatnonzero((frames.w[row] > 0) & body.posed)
    if len(k) < _LEAST_FRAMES:
        return None
    y, R = frames.y[row, k], body.R[k]
    velocity = np.gradient(y, frames.stamps[k] * 1e-9 - frames.stamps[k[0]] * 1e-9, axis=0)
    design = _columns(y, velocity, R, pivot, frames.dim)
    z = np.einsum("fji,fj->fi", R, y - body.t[k])
    # The row's place in the body is free, so only departures from the mean count.
    a = (design - design.mean(0)).reshape(-1, design.shape[2])
    r = (z - z.mean(0)).ravel()
    v = frames.tolerance[row]
    return a.T @ a / v, -a.T @ r / v, float(r @ r) / v, len(k) * frames.dim


def _summed(frames: Frames, rows: Ints, body: Body, pivot: Floats) -> Equations | None:
    found = [e for row in rows.tolist() if (e := _equations(frames, row, body, pivot)) is not None]
    if not found:
        return None
    left = np.sum([e[0] for e in found], 0)
    right = np.sum([e[1] for e in found], 0)
    return left, right, sum(e[2] for e in found), sum(e[3] for e in found)


def _solve(tables: list[list[Equations | None]], prior: Floats) -> Floats | None:
    """Each group takes the body that explains it best under its own fit; then one fit for all."""
    left, right = prior.copy(), np.zeros(len(prior))
    matched = False
    for table in tables:
        best = _best(table, prior)
        if best is not None:
            left, right, matched = left + best[0], right + best[1], True
    return np.asarray(np.linalg.solve(left, right), np.float64) if matched else None


def _best(table: list[Equations | None], prior: Floats) -> Equations | None:
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
