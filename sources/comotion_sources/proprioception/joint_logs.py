"""Reads logs of joints: CSV files and ROS 2 bags.

The header of a CSV log names the time first, as ``stamp_ns`` (integer nanoseconds) or as ``time``,
``t``, ``stamp`` or ``timestamp`` (seconds), then one column per joint with the joint's name (rad or m).
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from comotion_schemas.errors import KnownError
from comotion_schemas.ros_types import store
from comotion_schemas.time_units import seconds

from ..errors import InputError
from .samples import JOINT_STATE, JointSample, ros_sample

_MAX_LINE = 100_000
_MAX_JOINTS = 1000
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
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(_lines(path, file))
            header = [cell.strip() for cell in next(rows, [])]
            _check_header(path, header)
            first: list[int] = []
            for row in rows:
                if row:
                    sample = _csv_sample(path, rows.line_num, header, row)
                    if len(first) < _JUDGED:
                        first.append(sample.stamp_ns)
                        _judge(path, first)
                    yield sample
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a CSV file: {error}") from None


def _judge(path: Path, first: list[int]) -> None:
    """Judge the unit of the first stamps of a log, as soon as there are enough."""
    if len(first) == _JUDGED and first == sorted(set(first)):
        try:
            seconds([stamp / 1e9 for stamp in first])
        except KnownError as error:
            raise InputError(f"{path}: {error}") from None


def _lines(path: Path, file: TextIO) -> Iterator[str]:
    """Lines of a bounded length: a file without line ends may be larger than the memory."""
    while line := file.readline(_MAX_LINE + 1):
        if len(line) > _MAX_LINE:
            raise InputError(f"{path}: a line has more than {_MAX_LINE} characters")
        yield line


def _check_header(path: Path, header: list[str]) -> None:
    if not header or (header[0] != "stamp_ns" and header[0] not in _SECONDS):
        raise InputError(f"{path}: the first column must be stamp_ns or time, then one per joint")
    if len(header) > _MAX_JOINTS:
        raise InputError(f"{path}: more than {_MAX_JOINTS} columns")
    if len(header) < 2:
        raise InputError(f"{path}: no joint columns")


def _csv_sample(path: Path, line: int, header: list[str], row: list[str]) -> JointSample:
    try:
        if len(row) != len(header):
            raise InputError(f"{len(row)} cells, expected {len(header)}")
        stamp = int(row[0]) if header[0] == "stamp_ns" else round(float(row[0]) * 1e9)
        return JointSample(stamp, header[1:], np.array([float(cell) for cell in row[1:]]))
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}, line {line}: {error}") from None


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
