"""Interpolates joint states, so that a camera can render any instant."""

from collections import deque

import numpy as np

from comotion_schemas import JointStates

from .scene import Vector

_KEPT_NS = 2_000_000_000  # a camera renders at most this far behind the joint states
_GAP_NS = 500_000_000  # longer gaps are not interpolated


class JointHistory:
    """The last 2 s of a stream of joint states. Pure: no I/O, no clock.

    Parameters
    ----------
    joints
        Names of the joints of a configuration, in order; other joints in a message are ignored.

    Attributes
    ----------
    refused
        Number of messages that lacked a joint or were not newer than the one before.
    missing
        A joint that the last message lacked, or None.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._states: deque[tuple[int, Vector]] = deque()
        self._session = ""
        self._names: list[str] = []
        self._columns: list[int] = []
        self.refused = 0
        self.missing: str | None = None

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest state; None before the first."""
        return self._states[-1][0] if self._states else None

    def add(self, message: JointStates) -> None:
        """Add a message; a new session discards the states of the old one."""
        if message.session != self._session:
            self._session = message.session
            self._states.clear()
        newest = self.newest_ns
        if not self._find_columns(message.names) or (newest is not None and message.stamp_ns <= newest):
            self.refused += 1
            return
        self._states.append((message.stamp_ns, np.asarray(message.positions)[self._columns]))
        while self._states[0][0] < message.stamp_ns - _KEPT_NS:
            self._states.popleft()

    def at(self, stamp_ns: int) -> Vector | None:
        """Interpolate the configuration float64 [joints] at a stamp.

        Returns None outside the stored states, and within a gap of more than 0.5 s.
        """
        later: tuple[int, Vector] | None = None
        for stamp, state in reversed(self._states):
            if stamp == stamp_ns:
                return state
            if stamp < stamp_ns:
                if later is None or later[0] - stamp > _GAP_NS:
                    return None
                share = (stamp_ns - stamp) / (later[0] - stamp)
                return np.asarray(state + share * (later[1] - state))
            later = (stamp, state)
        return None

    def _find_columns(self, names: list[str]) -> bool:
        if names != self._names:
            columns = {name: index for index, name in enumerate(names)}
            self.missing = next((joint for joint in self._joints if joint not in columns), None)
            self._columns = [columns[joint] for joint in self._joints if joint in columns]
            self._names = names
        return self.missing is None
