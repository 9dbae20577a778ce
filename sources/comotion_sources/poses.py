"""Values over time, such as the pose of a carried camera: of a file, or of another source of the scene."""

import re
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Generic, TypeVar, cast

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from comotion_schemas import ObservationBatch
from comotion_schemas.component import Component
from comotion_schemas.errors import InputError, KnownError
from comotion_schemas.types import is_name

from .bounded import read_text
from .calibration.model import Extrinsics
from .source import Received

Value = TypeVar("Value")
# A line has some 40 bytes: a day at 30 Hz.
_MAX_BYTES = 100_000_000
_KEPT_NS = 10_000_000_000
_GAP_NS = 200_000_000
"""Poses are not interpolated across a longer gap."""
_POLL_S = 0.004
MAX_LAG_S = 0.5
"""How long a frame waits for its pose: the default of the service's `max_lag`."""


class Timed(Generic[Value]):
    """The last values of something that changes, by their stamps.

    `between` interpolates between two values, by the share of the way from the first to the second; values
    are kept for `kept_ns`, None: all of them; nothing is interpolated across more than `gap_ns`.
    """

    def __init__(
        self, between: Callable[[Value, Value, float], Value], kept_ns: int | None, gap_ns: int
    ) -> None:
        self._between, self._kept_ns, self._gap_ns = between, kept_ns, gap_ns
        self._values: deque[tuple[int, Value]] = deque()

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest value; None before the first."""
        return self._values[-1][0] if self._values else None

    def add(self, stamp_ns: int, value: Value) -> None:
        """Add a value; one that is not newer than the last is left out."""
        if self._values and stamp_ns <= self._values[-1][0]:
            return
        self._values.append((stamp_ns, value))
        while self._kept_ns is not None and self._values[0][0] < stamp_ns - self._kept_ns:
            self._values.popleft()

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()

    def at(self, stamp_ns: int) -> Value | None:
        """Value at an instant, interpolated; None beyond the values, and within a longer gap."""
        place = bisect_left(self._values, stamp_ns, key=lambda stamped: stamped[0])
        if place == len(self._values):
            return None
        late_ns, late = self._values[place]
        if late_ns == stamp_ns:
            return late
        if not place or late_ns - self._values[place - 1][0] > self._gap_ns:
            return None
        early_ns, early = self._values[place - 1]
        return self._between(early, late, (stamp_ns - early_ns) / (late_ns - early_ns))


class PoseBuffer(Timed[Extrinsics]):
    """The last poses of a carrier, such as the link of a robot that a camera is mounted on.

    `mount` leads from the camera to the carrier, None: the poses are those of the camera; poses are kept for
    `kept_ns`, None: all of them.
    """

    def __init__(self, mount: Extrinsics | None = None, kept_ns: int | None = _KEPT_NS) -> None:
        super().__init__(_between, kept_ns, _GAP_NS)
        self._mount = mount

    def at(self, stamp_ns: int) -> Extrinsics | None:
        """Pose of the camera at a stamp, interpolated; None beyond the stored poses and across a gap."""
        pose = super().at(stamp_ns)
        return pose if pose is None or self._mount is None else pose.after(self._mount)


def _between(early: Extrinsics, late: Extrinsics, share: float) -> Extrinsics:
    turns = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([early.rotation, late.rotation])))
    place = early.translation + share * (late.translation - early.translation)
    return Extrinsics(turns([share]).as_matrix()[0], place, late.frame)


def parse_carrier(text: str) -> tuple[str, int]:
    """Parse ``SOURCE:ID``, a 6-DoF feature of a source such as the link of a robot; the id is 0 if left out.

    Raises
    ------
    ValueError
        If it has not this form.
    """
    source, colon, feature = text.partition(":")
    if not is_name(source) or (colon and not feature.isdecimal()):
        raise KnownError(f"{text!r} is not SOURCE:ID, such as robot:3")
    return source, int(feature or 0)


class Carrier(PoseBuffer):
    """The poses of a camera by those of a feature that another source of the scene publishes.

    `mount` leads from the camera to the feature.
    """

    def __init__(self, component: Component, source: str, feature: int, mount: Extrinsics | None) -> None:
        super().__init__(mount)
        self._feature, self._stop = feature, component.stop
        self._batches = Received(component.session, component.keys.stream("obs", source), "obs")

    def at(self, stamp_ns: int) -> Extrinsics | None:
        """Pose at a stamp; waits until one as new has come, at most for :data:`MAX_LAG_S`."""
        end = time.monotonic() + MAX_LAG_S
        while True:
            for batch in self._batches.messages():
                add_poses(self, cast("ObservationBatch", batch), self._feature)
            newest = self.newest_ns
            if (newest is not None and newest >= stamp_ns) or time.monotonic() >= end:
                return super().at(stamp_ns)
            self._stop.wait(_POLL_S)


def add_poses(poses: PoseBuffer, batch: ObservationBatch, feature: int) -> None:
    """Add the poses of a feature in a batch to a buffer."""
    if batch.quaternions is None or batch.dim != 3:
        return
    rows = np.flatnonzero((batch.ids == feature) & np.isfinite(batch.quaternions[:, 0]))
    for row in rows.tolist():
        stamp = batch.stamp_ns if batch.stamps_ns is None else int(batch.stamps_ns[row])
        poses.add(
            stamp, Extrinsics.from_quaternion(batch.quaternions[row], batch.positions[row], batch.space)
        )


def read_trajectory(path: Path, mount: Extrinsics | None = None) -> PoseBuffer:
    """Read a trajectory in the format of TUM RGB-D: ``stamp tx ty tz qx qy qz qw`` a line, in seconds.

    `mount` leads from the camera to what these are poses of; None: they are those of the camera.

    Raises
    ------
    InputError
        If it cannot be read, a line is not of this form, or it has no pose.
    """
    buffer = PoseBuffer(mount, kept_ns=None)
    for stamp, pose in trajectory(path):
        buffer.add(stamp, pose)
    if buffer.newest_ns is None:
        raise InputError(f"{path}: no poses")
    return buffer


def trajectory(path: Path) -> Iterator[tuple[int, Extrinsics]]:
    """Yield stamps in ns and poses of a file as in :func:`read_trajectory`, with its errors."""
    return parsed(path, "stamp tx ty tz qx qy qz qw", _pose)


def _pose(line: str) -> tuple[int, Extrinsics]:
    stamp, *values = line.split()
    x, y, z, *turn = map(float, values)
    return stamp_ns(stamp), Extrinsics.from_quaternion(turn, [x, y, z])


def parsed(path: Path, form: str, parse: Callable[[str], Value]) -> Iterator[Value]:
    """Yield what the lines of a text file say, without comments.

    `form` is what a line is to be, for the error; `parse` reads a line, and raises ValueError.

    Raises
    ------
    InputError
        If it cannot be read; the message names the file, and the line that is not of this form.
    """
    for number, line in enumerate(map(str.strip, read_text(path, _MAX_BYTES).splitlines()), 1):
        if line and line[0] != "#":
            try:
                yield parse(line)
            except ValueError:
                raise InputError(f"{path}: line {number} is not '{form}'") from None


def stamp_ns(text: str) -> int:
    """Convert seconds in decimal notation to nanoseconds exactly; a float would lose digits.

    Raises
    ------
    ValueError
        If the text is not such a number.
    """
    match = re.fullmatch(r"(\d{1,10})(?:\.(\d*))?", text)
    if match is None:
        raise KnownError(f"{text!r} is not a time in seconds")
    return int(match[1]) * 1_000_000_000 + int((match[2] or "").ljust(9, "0")[:9])
