"""Motions of bodies: the simulator's, slower, stopped, coupled or on a hinge; and smooth ones. Pure."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_sources.simulator.actors import Path, Poses
from comotion_sources.simulator.spec import KeyStates, Motion, Rest, Sines

Array: TypeAlias = NDArray[np.float64]
PoseAt: TypeAlias = Callable[[Array], Poses]
"""Poses of a body at times float64 [T] in seconds of the scene."""

# The motion of the simulator's 3-D set: two sines an axis within a place of ±0.6 m.
SWINGING = Sines(kind="sines", within=0.6, amplitude=0.25, rotation=1.5)
_GRID_S, _RAMP_S = 0.02, 0.3
STILL: Array = np.zeros(3)


def simulated(motion: Motion, rng: np.random.Generator, dim: int = 3) -> PoseAt:
    """Draw a motion of the simulator."""
    return Path(motion, dim, rng).at


def resting(dim: int = 3) -> PoseAt:
    """Rest at the origin."""
    return simulated(Rest(), np.random.default_rng(0), dim)


def key_states(states: Sequence[Sequence[float]], dim: int = 3) -> PoseAt:
    """Interpolate linearly between states (t, position, rotation)."""
    motion = KeyStates(kind="key-states", states=[list(s) for s in states])
    return simulated(motion, np.random.default_rng(0), dim)


def glide(
    place: Array,
    velocity: Array = STILL,
    *,
    facing: Array = STILL,
    turn: Array = STILL,
    swing: Array = STILL,
) -> PoseAt:
    """Move smoothly: x(t) = place + velocity·t + swing·sin(π·t), R(t) = exp(turn·t)·exp(facing).

    All are float64 [3]: m and m/s, rotation vectors in rad and rad/s.
    """

    def at(times: Array) -> Poses:
        turned = Rotation.from_rotvec(times[:, None] * turn) * Rotation.from_rotvec(facing)
        moved = place + times[:, None] * velocity + np.sin(np.pi * times)[:, None] * swing
        return Poses(np.asarray(turned.as_matrix(), np.float64), np.asarray(moved, np.float64))

    return at


def stopping(motion: PoseAt, switches: Sequence[float], *, moving: bool) -> PoseAt:
    """Play a motion at a speed that goes between 0 and its own at given times, each time within 0.3 s.

    The `switches` increase by more than 0.3 s; `moving` says whether it moves at first.
    """
    knots, speeds = [0.0], [float(moving)]
    for time in switches:
        knots += [time, time + _RAMP_S]
        speeds += [speeds[-1], 1.0 - speeds[-1]]
    grid = np.arange(0.0, knots[-1] + _GRID_S, _GRID_S)
    speed = np.interp(grid, knots, speeds)
    phase = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * _GRID_S)])

    def at(times: Array) -> Poses:
        beyond = np.maximum(times - grid[-1], 0.0) * speeds[-1]
        return motion(np.interp(times, grid, phase) + beyond)

    return at


def at_speed(motion: PoseAt, speed: float) -> PoseAt:
    """Play a motion `speed` times as fast."""
    return lambda times: motion(np.asarray(times) * speed)


def looped(motion: PoseAt, length: float) -> PoseAt:
    """Play the first `length` seconds of a motion again and again."""
    return lambda times: motion(np.mod(times, length))


def coupled(leader: PoseAt, own: PoseAt, until: float, offset: Array) -> PoseAt:
    """Follow a leader rigidly `until` a time (s), then move on by a motion of its own.

    Its own changes of pose after that are added to the pose of that time; `offset` float64 [dim] is its
    place in the leader's axes.
    """
    end, base = leader(np.array([until])), own(np.array([until]))

    def at(times: Array) -> Poses:
        led, free = leader(times), own(times)
        turn = free.rotations @ base.rotations[0].T
        pivot = end.rotations[0] @ offset + end.translations[0]
        follows = (times < until)[:, None]
        place = led.translations + led.rotations @ offset
        return Poses(
            np.where(follows[..., None], led.rotations, turn @ end.rotations[0]),
            np.where(follows, place, pivot + free.translations - base.translations[0]),
        )

    return at


def chained(turns: Sequence[PoseAt], lengths: Array) -> PoseAt:
    """Middle of the last link of a chain that begins at the origin; each link turns about its start.

    `turns` rotate each link in the axes of the one before; `lengths` float64 [links], m, are along their
    first axes.
    """

    def at(times: Array) -> Poses:
        rotations, end = np.broadcast_to(np.eye(3), (len(times), 3, 3)), np.zeros((len(times), 3))
        middle = end
        for turn, length in zip(turns, lengths.tolist(), strict=True):
            rotations = rotations @ turn(times).rotations
            along = rotations[..., 0] * length
            middle, end = end + along / 2, end + along
        return Poses(rotations, middle)

    return at
