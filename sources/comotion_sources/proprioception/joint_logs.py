"""Reads logs of joints: CSV files and ROS 2 bags.

The header of a CSV log names the time first, as ``stamp_ns`` (integer nanoseconds) or as ``time``,
``t``, ``stamp`` or ``timestamp`` (seconds), then one column per joint with the joint's name (rad or m).
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from comotion_schemas.ros_types import store
from comotion_schemas.time_units import seconds

from ..bounded import read_cells
from ..errors import InputError
from .samples import JOINT_STATE, JointSample, ros_sample

# First samples by which the unit of time is judged.
_JUDGED = 8
_SECONDS = ("time", "t", "stamp", "timestamp")


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

    Parameters
    ----------
    path
        The bag file or folder.
    topic
        Topic of type ``sensor_msgs/msg/JointState``; None: the only topic of that type.

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
