"""Joint samples as they arrive: of a stream of the scene, a ROS 2 topic over Zenoh, or a log.

While none arrives, a reader yields None every 0.1 s, so that the caller can send samples that it holds back.
Malformed samples are counted and left out.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias, cast

from comotion_schemas import DecodeError, JointStates, decode_on
from comotion_schemas.ros_types import topic_key
from comotion_schemas.transport import SessionSettings

from ..errors import InputError
from ..runtime import SourcePublisher
from .samples import JointSample, ros_sample

Readings: TypeAlias = Iterator[JointSample | None]
Reader: TypeAlias = Callable[[SourcePublisher], Readings]
"""Reads until the stream ends or the source stops."""


def scene_joints(source: SourcePublisher, *, name: str) -> Readings:
    """Read the joint states of the scene from the key ``joints/<name>``."""
    return _received(source, source.component.keys.stream("joints", name), _from_wire)


def ros_topic(
    source: SourcePublisher, *, topic: str, domain: int = 0, settings: SessionSettings | None = None
) -> Readings:
    """Read ``sensor_msgs/msg/JointState`` live from a ROS 2 network that uses rmw_zenoh.

    Parameters
    ----------
    source
        Counts what is lost or malformed.
    topic, domain
        ROS topic and domain id.
    settings
        How to connect to the router of that network; None: use the session of the source.
    """
    key = topic_key(topic, domain, "sensor_msgs::msg::dds_::JointState_")
    return _received(source, key, lambda _, raw, received_ns: ros_sample(raw, received_ns), settings)


def played(
    source: SourcePublisher, *, samples: Iterable[JointSample], speed: float, original_stamps: bool
) -> Readings:
    """Play the samples of a log at the times they were recorded.

    Parameters
    ----------
    source
        Ends it when it stops.
    samples
        The samples of the log, in order.
    speed
        Recorded seconds per second of playback, above 0.
    original_stamps
        Keep the stamps of the log; else a sample gets the wall clock time at which it is played.
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
