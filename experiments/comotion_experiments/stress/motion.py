"""Motions of bodies: the simulator's, slower, stopped or in a chain. Pure."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_sources.simulator.actors import Path, Poses
from comotion_sources.simulator.spec import Motion, Sines

Array: TypeAlias = NDArray[np.float64]
PoseAt: TypeAlias = Callable[[Array], Poses]
"""Poses of a body at times float64 [T] in seconds of the scene."""

# The motion of the simulator's 3-D set: two sines an axis within a place of ±0.6 m.
SWINGING = Sines(kind="sines", within=0.6, amplitude=0.25, rotation=1.5)
_GRID_S, _RAMP_S = 0.02, 0.3


def simulated(motion: Motion, rng: np.random.Generator | None = None) -> PoseAt:
    """Draw a motion of the simulator; by default one in which nothing is random."""
    return Path(motion, 3, rng or np.random.default_rng(0)).at


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
