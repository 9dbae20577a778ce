"""Joint positions of a robot as they arrive: of a stream of the scene, a ROS 2 topic over Zenoh, or a log.

While none arrives, a live reader yields None every 0.1 s, so that the caller can send samples that it holds
back. Malformed samples are counted and left out.

The header of a CSV log names the time first, as ``stamp_ns`` (integer nanoseconds) or as ``time``,
``t``, ``stamp`` or ``timestamp`` (seconds), then one column per joint with the joint's name (rad or m).
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import DecodeError, JointStates, decode_on
from comotion_schemas.errors import InputError
from comotion_schemas.ros_types import from_cdr, stamp_of, store, topic_key
from comotion_schemas.time_units import seconds
from comotion_schemas.transport import SessionSettings

from ..bounded import read_cells
from ..runtime import SourcePublisher

Vector = NDArray[np.float64]
JOINT_STATE = "sensor_msgs/msg/JointState"
# First samples by which the unit of time is judged.
_JUDGED = 8
_SECONDS = ("time", "t", "stamp", "timestamp")


@dataclass(frozen=True, slots=True, eq=False)
class JointSample:
    """Joint positions at one instant.

    Raises
    ------
    InputError
        If names and positions do not match, a name occurs twice, or a position is not finite.
    """

    stamp_ns: int  # acquisition time, nanoseconds since the Unix epoch (in a log: the clock of the log)
    names: Sequence[str]  # names of the joints
    positions: Vector  # float64 [J], rad (hinge) or m (slide)

    def __post_init__(self) -> None:
        values = np.asarray(self.positions, np.float64)
        object.__setattr__(self, "positions", values)
        if values.shape != (len(self.names),):
            raise InputError(f"{len(self.names)} joint names but {values.size} positions")
        if len(set(self.names)) != len(self.names):
            raise InputError("a joint is named twice")
        if not np.isfinite(values).all():
            raise InputError("a joint position is not finite")
        if not 0 <= self.stamp_ns < 2**63:
            raise InputError(f"stamp {self.stamp_ns} is out of range")


def ros_sample(raw: bytes, received_ns: int) -> JointSample:
    """Read a ROS 2 JointState in CDR; one without a stamp gets the time of its receipt.

    Raises
    ------
    InputError
        If it is none, names and positions do not match, or a number is not finite.
    """
    message = from_cdr(raw, JOINT_STATE)
    return JointSample(stamp_of(message.header, received_ns), message.name, message.position)


def read_csv(path: Path) -> Iterator[JointSample]:
    """Yield the samples of a CSV log in the order of its lines.

    Raises
    ------
    InputError
        If the file is not such a log; the message names the line.
    """
    first: list[int] = []
    try:
        lines = read_cells(path)
        _, (time, *joints) = next(lines, (0, [""]))
        if time != "stamp_ns" and time not in _SECONDS:
            raise InputError("the first column must be stamp_ns or time, then one per joint")
        if not joints:
            raise InputError("no joint columns")
        for line, (stamp, *cells) in lines:
            try:
                stamp_ns = int(stamp) if time == "stamp_ns" else round(float(stamp) * 1e9)
                sample = JointSample(stamp_ns, joints, np.array([float(cell) for cell in cells]))
            except (ValueError, OverflowError) as error:
                raise InputError(f"line {line}: {error}") from None
            if len(first) < _JUDGED:
                first.append(sample.stamp_ns)
                if len(first) == _JUDGED and first == sorted(set(first)):
                    seconds([stamp_ns / 1e9 for stamp_ns in first])
            yield sample
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def read_bag(path: Path, topic: str | None = None) -> Iterator[JointSample]:
    """Yield the joint states of a ROS 2 bag: an MCAP or SQLite file, or a bag folder.

    A message without a stamp gets the time at which it was recorded.

    The `topic` has the type ``sensor_msgs/msg/JointState``; None: the only one of that type.

    Raises
    ------
    InputError
        If the file is not a bag, if there is no such topic or several, or if a message is malformed.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.interfaces import Connection

    def wanted(connection: Connection) -> bool:
        return connection.msgtype == JOINT_STATE and topic in (None, connection.topic)

    try:
        with AnyReader([path], default_typestore=store()) as reader:
            connections = [c for c in reader.connections if wanted(c)]
            topics = sorted({c.topic for c in connections})
            if len(topics) != 1:
                which = f"several: {', '.join(topics)}; name one" if topics else "none"
                called = f" named {topic}" if topic else ""
                raise InputError(f"{path}: topics with joint states{called}: {which}")
            for _, recorded_ns, raw in reader.messages(connections=connections):
                yield ros_sample(raw, recorded_ns)
    except (AnyReaderError, OSError) as error:
        raise InputError(f"{path}: {error}") from None


Readings: TypeAlias = Iterator[JointSample | None]
Reader: TypeAlias = Callable[[SourcePublisher], Readings]
"""Reads until the stream ends or the source stops."""


def scene_joints(source: SourcePublisher, *, name: str) -> Readings:
    """Read the joint states of the scene from the key ``joints/<name>``."""
    return _received(source, source.keys.stream("joints", name), _from_wire)


def ros_topic(
    source: SourcePublisher, *, topic: str, domain: int = 0, settings: SessionSettings | None = None
) -> Readings:
    """Read ``sensor_msgs/msg/JointState`` live from a ROS 2 network that uses rmw_zenoh.

    The `source` counts what is lost or malformed; `settings` say how to connect to the router of that
    network, None: in the session of the source.
    """
    key = topic_key(topic, domain, "sensor_msgs::msg::dds_::JointState_")
    return _received(source, key, lambda _, raw, received_ns: ros_sample(raw, received_ns), settings)


def played(
    source: SourcePublisher, *, samples: Iterable[JointSample], speed: float, original_stamps: bool
) -> Readings:
    """Play the samples of a log at the times they were recorded.

    It ends when the `source` stops. `samples` are in order, `speed` is in recorded seconds per second, above
    0. `original_stamps` keeps those of the log; else a sample gets the wall clock time at which it is played.
    """
    begin_wall, begin = time.time_ns(), time.monotonic()
    first: int | None = None
    for sample in samples:
        first = sample.stamp_ns if first is None else first
        elapsed = (sample.stamp_ns - first) / speed
        if source.stop.wait(max(0.0, begin + elapsed * 1e-9 - time.monotonic())):
            return
        stamp = sample.stamp_ns if original_stamps else begin_wall + round(elapsed)
        yield JointSample(stamp, sample.names, sample.positions)


def _received(
    source: SourcePublisher,
    key: str,
    read: Callable[[str, bytes, int], JointSample],
    settings: SessionSettings | None = None,
) -> Readings:
    for arrival in source.receive(key, settings):
        try:
            yield arrival and read(*arrival)
        except DecodeError as error:
            source.reject(error.reason)
        except InputError:
            source.reject("malformed")


def _from_wire(key: str, payload: bytes, _received_ns: int) -> JointSample:
    message = cast("JointStates", decode_on(key, payload))
    return JointSample(message.stamp_ns, message.names, message.positions)
