"""In groups of a source and bodies of the reference, out the offset that explains both best (step 2).

There are up to four explanations: the offset so far, fitted anew; no offset, fitted; a long delay, where no
group matches but one has the speeds of a body at another time; and none at all. The groups of the source are
matched with the bodies under each. The negative log evidence decides: what the matched groups gain, the prior
of the whole offset, and the share of the prior that its fit uses up.
Since nothing is carried over but a start, a wrong offset lasts only until the window shows motion that
contradicts it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Ints
from .frames import Frames
from .kernels.records import RowArrays
from .offset_equations import UNKNOWNS, Equations, normal_equations, velocities
from .procrustes import Body, pose_information

# Prior standard deviations, what a careful calibration leaves: rad, share of the scene's extent, s.
_ROTATION = float(np.radians(2.0))
_SHIFT = 0.03
_DELAY = 0.02
# s; that of the delay of a source that stamps what it sees when it arrives, not when it was taken; and the
# longest one. The speeds of a group and a body that are at least so alike, as a correlation, tell it. Chosen,
# as the next one, on made-up scenes with delays of .1 to .3 s and on stress scenes in which a clock is set.
_LATENCY, _LONGEST, _ALIKE = 0.2, 0.5, 0.8
# Mean squared residual, in tolerances, up to which a group moves like a body with such a delay: after a clock
# was set, a window holds two delays, and neither explains it all.
_LATE_RESIDUAL = 1.8
# s; an offset with a longer delay than this is one of such a source.
_MOST_DELAY = 3 * _DELAY
# Squared distance of an offset from none, in prior standard deviations, beyond which a group and a body are
# not taken for one, and mean squared residual, in tolerances, beyond which they do not move alike. Chosen
# on the scenes of docs/research/accuracy.md.
_MOST_OFFSET = 30.0
_MOST_RESIDUAL = 3.0
# Frames that a row and a body share at least.
_LEAST_FRAMES = 8
# Unknowns of (rotation, shift, delay) that exist in 2-D.
_PLANAR = np.array([2, 3, 4, 6])
# nat; by so much the evidence must speak against what is in force before it is replaced, by the scale of
# Kass and Raftery (1995), "Bayes factors": very strong.
_REPLACEMENT_MARGIN = 5.0
# Fits of an offset; groups that contradict the first are left out of the next.
_FITS = 2

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

    @classmethod
    def none(cls, pivot: Floats) -> "Offset":
        """No offset."""
        return cls(np.zeros(3), np.zeros(3), pivot, 0.0)

    @property
    def late(self) -> bool:
        """Whether its delay is that of a source that stamps what arrives."""
        return abs(self.delay) > _MOST_DELAY

    @property
    def vector(self) -> Floats:
        """Float64 [7], rotation, shift and minus the delay: what the steps of :meth:`after` add up to."""
        return np.concatenate([self.rotation, self.shift, [-self.delay]])

    def transform(self) -> tuple[Floats, Floats]:
        """R float64 [3, 3] and t [3] of x' = R x + t."""
        R = np.asarray(Rotation.from_rotvec(self.rotation).as_matrix(), np.float64)
        return R, self.pivot + self.shift - R @ self.pivot

    def after(self, step: Floats) -> "Offset":
        """The offset after a step, float64 [7], of the equations."""
        turn = Rotation.from_rotvec(step[:3])
        return replace(
            self,
            rotation=(turn * Rotation.from_rotvec(self.rotation)).as_rotvec(),
            shift=turn.apply(self.shift) + step[3:6],
            # y(t + delay) ~ y + ydot delay: what the fit adds to y, the times lose.
            delay=self.delay - float(step[6]),
        )


@dataclass(frozen=True)
class View:
    """What one source and the reference see.

    `groups` are rows of the source; `bodies` are fitted to the reference, by label; `extent` is the scale of
    the scene, in its unit; `delay` is the prior standard deviation of the delay, s, and `residual` the most
    that matched groups have, in tolerances.
    """

    frames: Frames
    groups: Groups
    bodies: dict[int, Body]
    extent: float
    delay: float = _DELAY
    residual: float = _MOST_RESIDUAL

    @cached_property
    def unknowns(self) -> Ints:
        """Indices of the unknowns that exist."""
        return np.arange(UNKNOWNS) if self.frames.dim == 3 else _PLANAR

    @cached_property
    def prior(self) -> Floats:
        """Inverse covariance of an offset, float64 [7, 7], or [4, 4] in 2-D."""
        spread = np.array([_ROTATION] * 3 + [_SHIFT * self.extent] * 3 + [self.delay])
        return np.diag(1 / spread[self.unknowns] ** 2)

    @cached_property
    def information(self) -> dict[int, Floats]:
        """Inverse covariance of the poses of each body, float64 [F, 6, 6]."""
        tolerance = self.frames.tolerance
        return {
            k: pose_information(self.frames, body.rows, body.template, tolerance[body.rows])
            for k, body in self.bodies.items()
        }


@dataclass(frozen=True)
class _Start:
    """An offset to fit from, and the equations at it of the groups that match a body."""

    offset: Offset
    at: Floats
    matched: list[Equations]


def explained(view: View, before: Offset) -> Offset:
    """The best explanation of what a source sees.

    Parameters
    ----------
    before
        The offset by which the frames of `view` are corrected.
    """
    none, late = Offset.none(before.pivot), replace(view, delay=_LATENCY, residual=_LATE_RESIDUAL)
    starts, margin = [(view, _start(view, before, before))], _REPLACEMENT_MARGIN
    if before.vector.any():
        starts, margin = [*starts, (view, _start(view, none, before))], -_REPLACEMENT_MARGIN
    still = np.zeros(len(view.prior))
    without = -sum(_gain(one, still) for one in starts[-1][1].matched)
    if before.late:
        starts.append((late, _start(late, before, before)))
    elif not starts[0][1].matched and (lag := _lag(view)):
        starts.append((late, _start(late, replace(before, delay=before.delay - lag), before)))
    offset, cost = min((_fit(*start) for start in starts), key=lambda fit: fit[1])
    return offset if cost + margin < without else none


def _lag(view: View) -> float:
    """How much later groups have the speeds of the bodies that they resemble most, s; 0 for unlike ones."""
    frames, count, step = view.frames, len(view.frames.stamps), view.frames.step
    longest = min(round(_LONGEST / max(step, 1e-9)), count // 3)
    own = np.stack([_speed(frames, rows) for rows in view.groups.values()])
    other = np.stack([_speed(frames, body.rows) for body in view.bodies.values()])
    alike = np.stack(
        [
            _correlation(own[:, max(k, 0) : count + min(k, 0)], other[:, max(-k, 0) : count - max(k, 0)])
            for k in range(-longest, longest + 1)
        ]
    )
    best = int(np.argmax(alike.sum(1)))
    return (best - longest) * step if alike[best].max() > _ALIKE else 0.0


def _correlation(a: Floats, b: Floats) -> Floats:
    """The largest correlation of each row [n, F] with others [m, F], of what both have (else NaN), [n]."""
    u, v = np.isfinite(a).astype(np.float64), np.isfinite(b).astype(np.float64)
    x, y = np.where(u > 0, a, 0.0), np.where(v > 0, b, 0.0)
    count = np.maximum(u @ v.T, 1.0)
    mean_x, mean_y = x @ v.T / count, u @ y.T / count
    both = x @ y.T / count - mean_x * mean_y
    spread = (x**2 @ v.T / count - mean_x**2) * (u @ (y**2).T / count - mean_y**2)
    found = both / np.sqrt(np.maximum(spread, 1e-300))
    return np.asarray(np.where(count >= a.shape[1] / 2, found, 0.0).max(1))


def _speed(frames: Frames, rows: Ints) -> Floats:
    """Mean speed of rows at each frame, [F]; NaN where none is seen."""
    seen = frames.w[rows] > 0
    speed = np.linalg.norm(velocities(frames.y[rows], seen, _seconds(frames)), axis=2)
    return np.where(seen.any(0), (speed * seen).sum(0) / np.maximum(seen.sum(0), 1), np.nan)


def _start(view: View, offset: Offset, before: Offset) -> _Start:
    """Match groups and bodies under an offset; the frames are corrected by `before`."""
    frames = view.frames
    arrays = frames.arrays if offset is before else _moved(view, offset, before)
    at = offset.vector[view.unknowns]
    found = [_match(view, arrays, one, at, offset.pivot) for one in sorted(view.groups)]
    return _Start(offset, at, [one for one in found if one is not None])


def _moved(view: View, offset: Offset, before: Offset) -> RowArrays:
    """The rows as they would be under another offset."""
    frames = view.frames
    (R, t), (R_before, t_before) = offset.transform(), before.transform()
    turn = R @ R_before.T
    rows = np.concatenate(list(view.groups.values()))
    y, w = frames.y.copy(), frames.w.copy()
    y[rows], w[rows] = _later(frames, rows, before.delay - offset.delay)
    y[rows] = y[rows] @ turn.T + t - turn @ t_before
    return frames.arrays._replace(y=y, w=w)


def _later(frames: Frames, rows: Ints, delay: float) -> tuple[Floats, Floats]:
    """Positions and weights of rows some s later: by whole frames, and from there by their velocity."""
    count, step = len(frames.stamps), frames.step
    whole = round(delay / step)
    at = np.arange(count) + whole
    some = np.clip(at, 0, count - 1)
    y, w = frames.y[rows][:, some], frames.w[rows][:, some] * (at == some)
    return y + (delay - whole * step) * velocities(y, w > 0, _seconds(frames)), w


def _fit(view: View, start: _Start) -> tuple[Offset, float]:
    """The most probable offset from a start, and its cost: minus the log evidence, by Laplace.

    Where the window says nothing, the offset stays at its start.
    """
    P, used = view.prior, start.matched
    step, left = np.zeros(len(P)), np.zeros(P.shape)
    for _ in range(_FITS):
        left = sum((one.left for one in used), np.zeros(P.shape))
        right = sum((one.right for one in used), np.zeros(len(P)))
        step = np.asarray(np.linalg.solve(left + P, right - P @ start.at), np.float64)
        used = [one for one in used if _gain(one, step) > 0]
    total = start.at + step
    cost = 0.5 * (total @ P @ total) - sum(_gain(one, step) for one in start.matched)
    cost += 0.5 * np.linalg.slogdet(np.eye(len(P)) + np.linalg.solve(P, left))[1]
    full = np.zeros(UNKNOWNS)
    full[view.unknowns] = np.linalg.solve(left + P, left @ step)
    return start.offset.after(full), float(cost)


def _match(view: View, arrays: RowArrays, own: int, at: Floats, pivot: Floats) -> Equations | None:
    """Equations of a group and the body that it moves with: that of its own label, else the best other."""
    rows, bodies = view.groups[own], view.bodies
    if own in bodies:
        first = _best([_equations(view, arrays, rows, own, pivot)], at, view)
        if first is not None:
            return first
    others = [k for k in bodies if k != own]
    return _best([_equations(view, arrays, rows, k, pivot) for k in others], at, view)


def _equations(view: View, arrays: RowArrays, rows: Ints, k: int, pivot: Floats) -> Equations:
    """Equations of rows and one body, in the unknowns that exist."""
    frames, some = view.frames, view.unknowns
    terms = arrays, _seconds(frames), rows, view.bodies[k], view.information[k], pivot
    found = normal_equations(*terms, frames.dim, _LEAST_FRAMES)
    left, right = found.left[np.ix_(some, some)], found.right[some]
    return found._replace(left=left, right=right)


def _gain(one: Equations, step: Floats) -> float:
    """Nats that a step gains over a group that moves like no body."""
    return max(_MOST_RESIDUAL * one.coordinates - _after(one, step), 0.0) / 2


def _after(one: Equations, step: Floats) -> float:
    """Squared residual after a step."""
    return float(one.squared - 2 * step @ one.right + step @ one.left @ step)


def _seconds(frames: Frames) -> Floats:
    return np.asarray((frames.stamps - frames.stamps[0]) * 1e-9, np.float64)


def _best(candidates: list[Equations], at: Floats, view: View) -> Equations | None:
    """The equations that gain most after their own step; None where none fits well enough."""
    chosen, most, prior = None, 0.0, view.prior
    for one in candidates:
        step = np.asarray(np.linalg.solve(one.left + prior, one.right - prior @ at), np.float64)
        penalty = float((at + step) @ prior @ (at + step))
        gain = _gain(one, step) - penalty / 2
        fits = penalty < _MOST_OFFSET and _after(one, step) < view.residual * one.coordinates
        if gain > most and fits:
            chosen, most = one, gain
    return chosen
