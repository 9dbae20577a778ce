"""Moves the bodies of a simulated scene."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .spec import KeyStates, Motion, Rest, Sines

Array: TypeAlias = NDArray[np.float64]
_SINES = 2  # per axis, as the class Sines documents
_AMPLITUDE_FACTOR = (0.7, 1.3)


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of one body at T times: x = rotations @ body coordinates + translations.

    Attributes
    ----------
    rotations
        float64 [T, dim, dim].
    translations
        float64 [T, dim].
    """

    rotations: Array
    translations: Array


class Path:
    """The motion of one body; random parameters are drawn at construction.

    Parameters
    ----------
    motion
        Specification of the motion.
    dim
        2 or 3.
    rng
        Generator for places, frequencies, phases and amplitudes.
    """

    def __init__(self, motion: Motion, dim: int, rng: np.random.Generator) -> None:
        self._motion = motion
        self._dim = dim
        self._turn = 1 if dim == 2 else 3
        if isinstance(motion, KeyStates):
            self._states = np.array(motion.states, np.float64)
            return
        drawn = rng.uniform(-motion.within, motion.within, dim)
        self._place = drawn if motion.at is None else np.array(motion.at, np.float64)
        if isinstance(motion, Sines):
            self._draw_sines(motion, rng)

    def at(self, times: Array) -> Poses:
        """Compute the poses at times float64 [T], seconds of the scene."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        state = self._state(times)
        return Poses(_rotations(state[:, self._dim :]), state[:, : self._dim])

    def _state(self, times: Array) -> Array:
        """Position and rotation coordinates: [T, 2 + 1] or [T, 3 + 3]."""
        if isinstance(self._motion, KeyStates):
            knots = self._states[:, 0]
            return np.stack([np.interp(times, knots, column) for column in self._states.T[1:]], axis=1)
        rest = np.concatenate([self._place, np.zeros(self._turn)])
        if isinstance(self._motion, Rest):
            return np.tile(rest, (len(times), 1))
        shift = self._swing(np.maximum(times - self._motion.start, 0.0))
        if self._motion.start > 0:  # the motion starts at the place of rest
            shift = shift - self._swing(np.zeros(1))
        return rest + shift

    def _draw_sines(self, motion: Sines, rng: np.random.Generator) -> None:
        shape = (_SINES, self._dim + self._turn)
        reach = np.r_[np.full(self._dim, motion.amplitude), np.full(self._turn, motion.rotation)]
        self._frequency = rng.uniform(motion.frequency.min, motion.frequency.max, shape)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, shape)
        self._amplitude = rng.uniform(*_AMPLITUDE_FACTOR, shape) * reach / _SINES

    def _swing(self, times: Array) -> Array:
        angle = 2.0 * np.pi * self._frequency * times[:, None, None] + self._phase
        return np.asarray((self._amplitude * np.sin(angle)).sum(axis=1), np.float64)


def _rotations(turn: Array) -> Array:
    """Convert angles [T, 1] or rotation vectors [T, 3] to rotation matrices."""
    if turn.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(turn).as_matrix(), np.float64)
    cos, sin = np.cos(turn[:, 0]), np.sin(turn[:, 0])
    return np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)


def seen_from(body: Poses, camera: Poses) -> Poses:
    """Transform poses of a body to the frame of a moving camera; both at the same T times."""
    back = np.swapaxes(camera.rotations, 1, 2)
    return Poses(
        back @ body.rotations,
        np.einsum("tij,tj->ti", back, body.translations - camera.translations),
    )
