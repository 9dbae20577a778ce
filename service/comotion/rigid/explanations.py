"""Finds the offset of a source that best explains its groups by the bodies of the reference (step 2).

Up to four explanations are compared: the offset so far, fitted anew; no offset, fitted; a long delay, where
no group matches but one has the speeds of a body at another time; and none at all. The groups of the source
are matched with the bodies under each. The negative log evidence decides: what the matched groups gain, the
prior of the whole offset, and the share of the prior that its fit uses up. Since nothing is carried over but
a start, a wrong offset lasts only until the window shows motion that contradicts it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Ints
from .frames import FEWEST, Frames
from .kernels.records import RowArrays
from .offset_equations import UNKNOWNS, Equations, normal_equations, velocities
from .procrustes import Body, pose_information

# Prior standard deviations, those of a careful calibration: rad, share of the scene's extent, s.
_ROTATION = float(np.radians(2.0))
_SHIFT = 0.03
_DELAY = 0.02
# Of a source that stamps observations on arrival, not when they were made: prior standard deviation of its
# delay and longest delay, s, and least correlation of the speeds of a group and a body from which a delay is
# read. Chosen, as the next one, on made-up scenes with delays of .1 to .3 s and on stress scenes in which a
# clock is set.
_LATENCY, _LONGEST, _ALIKE = 0.2, 0.5, 0.8
# Mean squared residual, in tolerances, up to which a group moves like a body with such a delay: after a clock
# was set, a window holds two delays, and neither explains it all.
_LATE_RESIDUAL = 1.8
# Squared distance of an offset from none, in prior standard deviations, beyond which a group and a body are
# not taken for one, and mean squared residual, in tolerances, beyond which they do not move alike. Chosen
# on the scenes of docs/research/accuracy.md.
_MOST_OFFSET = 30.0
_MOST_RESIDUAL = 3.0
# Unknowns of (rotation, shift, delay) that exist in 2-D.
_PLANAR = np.array([2, 3, 4, 6])
# nat; margin of the evidence against the offset in force before it is replaced; "very strong" on the scale of
# Kass and Raftery (1995), "Bayes factors".
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
        """Whether its delay is that of a source that stamps observations on arrival."""
        return abs(self.delay) > 3 * _DELAY

    @property
    def vector(self) -> Floats:
        """Float64 [7], rotation, shift and minus the delay: the sum of the steps of :meth:`after`."""
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
            # y(t + delay) ~ y + ydot delay: a positive step in y is a negative one of the times.
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
    vector: Floats
    matched: list[Equations]


def explained(view: View, applied: Offset) -> Offset:
    """The best explanation of the motion that a source sees.

    Parameters
    ----------
    applied
        The offset by which the frames of `view` are corrected.
    """
    none, late = Offset.none(applied.pivot), replace(view, delay=_LATENCY, residual=_LATE_RESIDUAL)
    starts, margin = [(view, _start(view, applied, applied))], _REPLACEMENT_MARGIN
    if applied.vector.any():
        starts, margin = [*starts, (view, _start(view, none, applied))], -_REPLACEMENT_MARGIN
    still = np.zeros(len(view.prior))
    without = -sum(_gain(match, still) for match in starts[-1][1].matched)
    if applied.late:
        starts.append((late, _start(late, applied, applied)))
    elif not starts[0][1].matched and (lag := _lag(view)):
        starts.append((late, _start(late, replace(applied, delay=applied.delay - lag), applied)))
    offset, cost = min((_fit(*start) for start in starts), key=lambda fit: fit[1])
    return offset if cost + margin < without else none


def _lag(view: View) -> float:
    """How much later groups have the speeds of the bodies that they resemble most, s; 0 for unlike ones."""
    frames, count, step = view.frames, len(view.frames.stamps), view.frames.step
    longest = min(round(_LONGEST / max(step, 1e-9)), count // 3)
    own = np.stack([_speed(frames, rows) for rows in view.groups.values()])
    other = np.stack([_speed(frames, body.rows) for body in view.bodies.values()])
    correlations = np.stack(
        [
            _correlation(own[:, max(k, 0) : count + min(k, 0)], other[:, max(-k, 0) : count - max(k, 0)])
            for k in range(-longest, longest + 1)
        ]
    )
    best = int(np.argmax(correlations.sum(1)))
    return (best - longest) * step if correlations[best].max() > _ALIKE else 0.0


def _correlation(a: Floats, b: Floats) -> Floats:
    """The largest correlation of each row [n, F] with others [m, F], of what both have (else NaN), [n]."""
    u, v = np.isfinite(a).astype(np.float64), np.isfinite(b).astype(np.float64)
    x, y = np.where(u > 0, a, 0.0), np.where(v > 0, b, 0.0)
    count = np.maximum(u @ v.T, 1.0)
    mean_x, mean_y = x @ v.T / count, u @ y.T / count
    covariance = x @ y.T / count - mean_x * mean_y
    spread = (x**2 @ v.T / count - mean_x**2) * (u @ (y**2).T / count - mean_y**2)
    correlation = covariance / np.sqrt(np.maximum(spread, 1e-300))
    return np.asarray(np.where(count >= a.shape[1] / 2, correlation, 0.0).max(1))


def _speed(frames: Frames, rows: Ints) -> Floats:
    """Mean speed of rows at each frame, [F]; NaN where none is seen."""
    seen = frames.w[rows] > 0
    speed = np.linalg.norm(velocities(frames.y[rows], seen, _seconds(frames)), axis=2)
    return np.where(seen.any(0), (speed * seen).sum(0) / np.maximum(seen.sum(0), 1), np.nan)


def _start(view: View, offset: Offset, applied: Offset) -> _Start:
    """Match groups and bodies under an offset; the frames are corrected by `applied`."""
    frames = view.frames
    arrays = frames.arrays if offset is applied else _moved(view, offset, applied)
    vector = offset.vector[view.unknowns]
    matches = [_match(view, arrays, label, vector, offset.pivot) for label in sorted(view.groups)]
    return _Start(offset, vector, [match for match in matches if match is not None])


def _moved(view: View, offset: Offset, applied: Offset) -> RowArrays:
    """The rows as they would be under another offset."""
    frames = view.frames
    (R, t), (R_applied, t_applied) = offset.transform(), applied.transform()
    turn = R @ R_applied.T
    rows = np.concatenate(list(view.groups.values()))
    y, w = frames.y.copy(), frames.w.copy()
    y[rows], w[rows] = _later(frames, rows, applied.delay - offset.delay)
    y[rows] = y[rows] @ turn.T + t - turn @ t_applied
    return frames.arrays._replace(y=y, w=w)


def _later(frames: Frames, rows: Ints, delay: float) -> tuple[Floats, Floats]:
    """Positions and weights of rows some s later: by whole frames, and from there by their velocity."""
    count, step = len(frames.stamps), frames.step
    whole = round(delay / step)
    shifted = np.arange(count) + whole
    inside = np.clip(shifted, 0, count - 1)
    y, w = frames.y[rows][:, inside], frames.w[rows][:, inside] * (shifted == inside)
    return y + (delay - whole * step) * velocities(y, w > 0, _seconds(frames)), w


def _fit(view: View, start: _Start) -> tuple[Offset, float]:
    """The most probable offset from a start, and its cost: minus the log evidence, by Laplace.

    Where the window says nothing, the offset stays at its start.
    """
    P, used = view.prior, start.matched
    step, left = np.zeros(len(P)), np.zeros(P.shape)
    for _ in range(_FITS):
        left = sum((match.left for match in used), np.zeros(P.shape))
        right = sum((match.right for match in used), np.zeros(len(P)))
        step = np.asarray(np.linalg.solve(left + P, right - P @ start.vector), np.float64)
        used = [match for match in used if _gain(match, step) > 0]
    total = start.vector + step
    cost = 0.5 * (total @ P @ total) - sum(_gain(match, step) for match in start.matched)
    cost += 0.5 * np.linalg.slogdet(np.eye(len(P)) + np.linalg.solve(P, left))[1]
    full = np.zeros(UNKNOWNS)
    full[view.unknowns] = np.linalg.solve(left + P, left @ step)
    return start.offset.after(full), float(cost)


def _match(view: View, arrays: RowArrays, label: int, vector: Floats, pivot: Floats) -> Equations | None:
    """Equations of a group and the body that it moves with: that of its own label, else the best other."""
    rows, bodies = view.groups[label], view.bodies
    if label in bodies:
        own_match = _best([_equations(view, arrays, rows, label, pivot)], vector, view)
        if own_match is not None:
            return own_match
    other_labels = [k for k in bodies if k != label]
    return _best([_equations(view, arrays, rows, k, pivot) for k in other_labels], vector, view)


def _equations(view: View, arrays: RowArrays, rows: Ints, k: int, pivot: Floats) -> Equations:
    """Equations of rows and one body, in the unknowns that exist."""
    frames, unknowns = view.frames, view.unknowns
    terms = arrays, _seconds(frames), rows, view.bodies[k], view.information[k], pivot
    equations = normal_equations(*terms, frames.dim, FEWEST)
    left, right = equations.left[np.ix_(unknowns, unknowns)], equations.right[unknowns]
    return equations._replace(left=left, right=right)


def _gain(match: Equations, step: Floats) -> float:
    """Nats that a step gains over a group that moves like no body."""
    return max(_MOST_RESIDUAL * match.coordinates - _after(match, step), 0.0) / 2


def _after(match: Equations, step: Floats) -> float:
    """Squared residual after a step."""
    return float(match.squared - 2 * step @ match.right + step @ match.left @ step)


def _seconds(frames: Frames) -> Floats:
    return np.asarray((frames.stamps - frames.stamps[0]) * 1e-9, np.float64)


def _best(candidates: list[Equations], vector: Floats, view: View) -> Equations | None:
    """The equations that gain most after their own step; None where none fits well enough."""
    best, most_gain, prior = None, 0.0, view.prior
    for match in candidates:
        step = np.asarray(np.linalg.solve(match.left + prior, match.right - prior @ vector), np.float64)
        penalty = float((vector + step) @ prior @ (vector + step))
        gain = _gain(match, step) - penalty / 2
        fits = penalty < _MOST_OFFSET and _after(match, step) < view.residual * match.coordinates
        if gain > most_gain and fits:
            best, most_gain = match, gain
    return best
