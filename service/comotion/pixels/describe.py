"""Describes groups beside their members: whether and how they move, and how well they fit."""

from dataclasses import replace

import numpy as np

from comotion_schemas import Twist
from comotion_schemas.hypotheses import HypothesisState

from ..arrays import Bools, Floats, Ints, Slots, median
from ..partition import Group
from ..trajectories.window import Window
from .key_frames import KeyFrames

# A velocity is taken over the newest half second, of features observed over at least a fifth: one step alone
# has the noise of both its ends.
_VELOCITY_NS = 500_000_000
_LEAST_HISTORY_NS = 200_000_000
# px; KLT noise and its drift over the time a velocity is taken over stay below this.
_AT_REST_PX = 1.5
# Variances of a displacement, and px of drift, within which a trajectory rests all the time.
_GATE, _DRIFT_PX = 9.0, 0.15
# Share of the members at rest from which on a group of a camera that moves rests as a whole.
_MOST_AT_REST = 0.5


def describe(window: Window, current: Slots, groups: Ints, variance: Floats, count: int) -> list[Group]:
    """Describe groups 0 to `count` - 1 of the current trajectories.

    Parameters
    ----------
    current, groups
        Slots intp [n] and their groups intp [n], negative for none.
    variance
        float64 [n], px²; noise of a coordinate of each, NaN unknown.
    """
    position = window.newest(current)
    step, span = window.recent_steps(current, _VELOCITY_NS)
    described = []
    for k in range(count):
        members = np.flatnonzero(groups == k)
        steady = members[span[members] >= _LEAST_HISTORY_NS]
        known = variance[members][np.isfinite(variance[members])]
        described.append(
            Group(
                state=_state(step[steady], len(members)),
                twist=_twist(position[steady], step[steady] / (span[steady, None] * 1e-9)),
                noise=float(np.sqrt(median(known))) if len(known) else None,
            )
        )
    return described


def of_moving_camera(groups: list[Group]) -> list[Group]:
    """Groups before a camera that moves: what rests in the image then is far away, or moves along with it."""
    if all(group.state != "moving" for group in groups):
        return groups
    return [replace(group, state="undetermined") if group.state == "static" else group for group in groups]


def alone_at_rest(frames: KeyFrames, labels: Ints) -> Bools:
    """Which of N trajectories rest in the image all the time while their group, intp [N], moves: bool [N].

    Those seen on half of the key frames at least are looked at. They may be far away, or move as the camera
    does: it is not known which body they belong to.
    """
    first = frames.positions[frames.visible.argmax(axis=0), np.arange(len(labels))]
    square = np.where(frames.visible, ((frames.positions - first) ** 2).sum(axis=2), 0).max(axis=0)
    rests = (square < _GATE * 2 * (frames.variance + _DRIFT_PX**2)) & (frames.visible.mean(axis=0) >= 0.5)
    share = np.bincount(labels, rests) / np.maximum(np.bincount(labels), 1)
    return np.asarray(rests & (share[labels] < _MOST_AT_REST))


def _state(steps: Floats, members: int) -> HypothesisState:
    if not len(steps) or 2 * len(steps) < members:
        return "undetermined"
    # The median: a few members that belong to others do not make a body move.
    return "moving" if median(np.linalg.norm(steps, axis=1)) > _AT_REST_PX else "static"


def _twist(position: Floats, velocity: Floats) -> Twist | None:
    """Least squares of v = v_c + ω × r in the image, px/s and rad/s."""
    if not len(position):
        return None
    r = position - position.mean(axis=0)
    linear = velocity.mean(axis=0)
    moment = (r[:, 0] * velocity[:, 1] - r[:, 1] * velocity[:, 0]).sum()
    inertia = (r**2).sum()
    return Twist(linear=linear.tolist(), angular=float(moment / inertia) if inertia > 0 else 0.0)
