"""Interpolates joint states, so that a camera can render any instant."""

import numpy as np

from comotion_schemas import JointStates

from ..timed import Timed
from .scene import Vector

_KEPT_NS = 2_000_000_000  # a camera renders at most this far behind the joint states
_GAP_NS = 500_000_000  # longer gaps are not interpolated


class JointHistory(Timed[Vector]):
    """The last 2 s of a stream of joint states. Pure: no I/O, no clock.

    Parameters
    ----------
    joints
        Names of the joints of a configuration, in order; other joints in a message are ignored.

    Attributes
    ----------
    missing
        A joint that the last message lacked, or None.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        super().__init__(_KEPT_NS, _GAP_NS)
        self._joints = joints
        self._session = ""
        self._names: list[str] = []
        self._columns: list[int] = []
        self.missing: str | None = None

    def take(self, message: JointStates) -> None:
        """Add a message; a new session discards the states of the old one."""
        if message.session != self._session:
            self._session = message.session
            self.clear()
        if message.names != self._names:
            columns = {name: index for index, name in enumerate(message.names)}
            self.missing = next((joint for joint in self._joints if joint not in columns), None)
            self._columns = [columns[joint] for joint in self._joints if joint in columns]
            self._names = message.names
        if self.missing is None:
            self.add(message.stamp_ns, np.asarray(message.positions)[self._columns])

    def at(self, stamp_ns: int) -> Vector | None:
        """Interpolate the configuration float64 [joints] at a stamp.

        Returns None outside the stored states, and within a gap of more than 0.5 s.
        """
        states = self.around(stamp_ns)
        if states is None:
            return None
        early, late, share = states
        return np.asarray(early + share * (late - early))
