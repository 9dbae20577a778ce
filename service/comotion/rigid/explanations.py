"""Finds the offset of a source that best explains its groups by the bodies of the reference (step 2).

Up to four explanations are compared: the offset so far, fitted anew; no offset, fitted; a long delay, where
no group matches but one has the speeds of a body at another time; and none at all. The groups of the source
are matched with the bodies under each. The negative log evidence decides: what the matched groups gain, the
prior of the whole offset, and the share of the prior that its fit uses up. Since nothing is carried over but
a start, a wrong offset lasts only until the window shows motion that contradicts it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats, Ints
from ..geometry.body import Body, pose_information
from ..geometry.frames import Frames
from .offset_equations import UNKNOWNS, Equations, normal_equations, velocities

# Prior standard deviations, those of a careful calibration: rad, share of the scene's extent, s.
_ROTATION = float(np.radians(2.0))
_SHIFT = 0.03
_DELAY = 0.02
# Of a source that stamps observations on arrival, not when they were made: prior standard deviation of its
# delay and longest delay, s, and least correlation of the speeds of a group and a body from which a delay is
# read. Chosen on made-up scenes with delays of .1 to .3 s and on stress scenes in which a clock is set.
_LATENCY, _LONGEST, _ALIKE = 0.2, 0.5, 0.8
# Squared distance of an offset from none, in prior standard deviations, beyond which a group and a body are
# not taken for one, and mean squared residual, in tolerances, beyond which they do not move alike. Chosen
# on the scenes of docs/research/accuracy.md.
_MOST_OFFSET = 30.0
_MOST_RESIDUAL = 3.0
# nat; margin of the evidence against the offset in force before it is replaced; "very strong" on the scale of
# Kass and Raftery (1995), "Bayes factors".
_REPLACEMENT_MARGIN = 5.0

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

    `groups` are rows of the source; `bodies` are fitted to the reference, by label; `delay` is the prior
    standard deviation of the delay, s.
    """

    frames: Frames
    groups: Groups
    bodies: dict[int, Body]
    delay: float = _DELAY

    @cached_property
    def prior(self) -> Floats:
        """Inverse covariance of an offset, float64 [7, 7]."""
        return np.diag(np.array([_ROTATION] * 3 + [_SHIFT * self.frames.extent] * 3 + [self.delay]) ** -2.0)

    @cached_property
    def information(self) -> dict[int, Floats]:
        """Inverse covariance of the poses of each body, float64 [F, 6, 6]."""
        frames = self.frames
        terms = {
            k: (body.rows, body.template, frames.tolerance[body.rows]) for k, body in self.bodies.items()
        }
        return {k: pose_information(frames, *of_body) for k, of_body in terms.items()}


class _Fit(NamedTuple):
    """A fitted offset, minus its log evidence, and the equations of the groups that match a body."""

    offset: Offset
    cost: float
    matched: list[Equations]


def explained(view: View, applied: Offset) -> Offset:
    """The best explanation of the motion that a source sees.

    Parameters
    ----------
    applied
        The offset by which the frames of `view` are corrected.
    """
    none, late = Offset.none(applied.pivot), replace(view, delay=_LATENCY)
    fits, margin = [_fit(view, applied, applied)], _REPLACEMENT_MARGIN
    if applied.vector.any():
        fits, margin = [*fits, _fit(view, none, applied)], -_REPLACEMENT_MARGIN
    without = -sum(_gain(match, np.zeros(UNKNOWNS)) for match in fits[-1].matched)
    if applied.late:
        fits.append(_fit(late, applied, applied))
    elif not fits[0].matched and (lag := _lag(view)):
        fits.append(_fit(late, replace(applied, delay=applied.delay - lag), applied))
    best = min(fits, key=lambda fit: fit.cost)
    return best.offset if best.cost + margin < without else none


def _lag(view: View) -> float:
    """How much later groups have the speeds of the bodies that they resemble most, s; 0 for unlike ones."""
    frames, count, step = view.frames, len(view.frames.stamps), view.frames.step
    longest = min(round(_LONGEST / max(step, 1e-9)), count // 3)
    own = np.stack([_speed(frames, rows) for rows in view.groups.values()])
    other = np.stack([_speed(frames, body.rows) for body in view.bodies.values()])
    alike = np.zeros((2 * longest + 1, len(own)))
    for k in range(-longest, longest + 1):
        a, b = own[:, max(k, 0) : count + min(k, 0)], other[:, max(-k, 0) : count - max(k, 0)]
        squares = (a**2 @ (b != 0).T) * ((a != 0) @ b.T**2)
        alike[k + longest] = (a @ b.T / np.sqrt(np.maximum(squares, 1e-300))).max(1)
    best = int(np.argmax(alike.sum(1)))
    return (best - longest) * step if alike[best].max() > _ALIKE else 0.0


def _speed(frames: Frames, rows: Ints) -> Floats:
    """Mean speed of rows at each frame, less that over time, [F]; 0 where none is seen."""
    speed = np.linalg.norm(velocities(frames.y[rows], frames.w[rows] > 0, frames.step), axis=2)
    seen = np.isfinite(speed)
    mean = np.nan_to_num(speed).sum(0) / np.maximum(seen.sum(0), 1)
    return np.asarray((mean - mean[seen.any(0)].mean()) * seen.any(0))


def _matches(view: View, offset: Offset, applied: Offset) -> list[Equations]:
    """Match groups and bodies under an offset; the frames are corrected by `applied`."""
    matches = []
    for label, rows in sorted(view.groups.items()):
        group = view.frames, rows, *_moved(view.frames, rows, offset, applied)
        own, others = [k for k in view.bodies if k == label], [k for k in view.bodies if k != label]
        for candidates in own, others:  # that of its own label, else the best other
            pairs = [(view.bodies[k], view.information[k]) for k in candidates]
            equations = [normal_equations(*group, *pair, offset.pivot) for pair in pairs]
            if (match := _best(equations, offset.vector, view.prior)) is not None:
                matches.append(match)
                break
    return matches


def _moved(frames: Frames, rows: Ints, offset: Offset, applied: Offset) -> tuple[Floats, Floats]:
    """Positions and weights of rows as they would be under another offset than `applied`.

    They are later by whole frames, and from there by their velocity.
    """
    y, w = frames.y[rows], frames.w[rows]
    if offset is applied:
        return y, w
    (R, t), (R_applied, t_applied) = offset.transform(), applied.transform()
    delay, frame = applied.delay - offset.delay, np.arange(len(frames.stamps))
    whole = round(delay / frames.step)
    inside = np.clip(frame + whole, 0, frame[-1])
    y, w = y[:, inside], w[:, inside] * (frame + whole == inside)
    # Frames without a velocity stay: evidence is compared on the same ones.
    y += (delay - whole * frames.step) * np.nan_to_num(velocities(y, w > 0, frames.step))
    turn = R @ R_applied.T
    return y @ turn.T + t - turn @ t_applied, w


def _fit(view: View, start: Offset, applied: Offset) -> _Fit:
    """The most probable offset from a start, by Laplace; the frames are corrected by `applied`.

    Where the window says nothing, the offset stays at its start.
    """
    matched, P, vector = _matches(view, start, applied), view.prior, start.vector
    left = sum((match.left for match in matched), np.zeros(P.shape))
    right = sum((match.right for match in matched), np.zeros(UNKNOWNS))
    step = np.asarray(np.linalg.solve(left + P, right - P @ vector), np.float64)
    total = vector + step
    cost = 0.5 * (total @ P @ total) - sum(_gain(match, step) for match in matched)
    cost += 0.5 * np.linalg.slogdet(np.eye(UNKNOWNS) + np.linalg.solve(P, left))[1]
    seen = np.asarray(np.linalg.solve(left + P, left @ step), np.float64)
    return _Fit(start.after(seen), float(cost), matched)


def _gain(match: Equations, step: Floats) -> float:
    """Nats that a step gains over a group that moves like no body."""
    return max(_MOST_RESIDUAL * match.coordinates - match.after(step), 0.0) / 2


def _best(candidates: list[Equations], vector: Floats, prior: Floats) -> Equations | None:
    """The equations that gain most after their own step; None where none fits well enough."""
    best, most_gain = None, 0.0
    for match in candidates:
        step = np.asarray(np.linalg.solve(match.left + prior, match.right - prior @ vector), np.float64)
        penalty = float((vector + step) @ prior @ (vector + step))
        gain = _gain(match, step) - penalty / 2
        fits = penalty < _MOST_OFFSET and match.after(step) < _MOST_RESIDUAL * match.coordinates
        if gain > most_gain and fits:
            best, most_gain = match, gain
    return best
