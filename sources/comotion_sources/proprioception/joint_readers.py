"""Joint readers: a stream of the scene, a ROS 2 topic over Zenoh, or a log -> joint samples.

A reader yields samples as they arrive. While none arrives it yields None every 0.1 s, so that the
caller can send samples that it holds back. Malformed samples are counted and left out.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias, cast

from comotion_schemas import DecodeError, JointStates, decode_on
from comotion_schemas.transport import SessionSettings

from ..errors import InputError
from ..received import Received, subscribed
from ..runtime import SourcePublisher
from .cdr import decode_message, from_message, ros_key
from .samples import JointSample, joint_sample

_Read: TypeAlias = Callable[[str, bytes, int], JointSample]


class JointReader(Protocol):
    """A source of joint samples."""

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Yield samples, or None while none arrives, until the stream ends or the source stops."""
        ...


@dataclass(frozen=True)
class SceneJoints:
    """Reads the joint states of the scene from the key ``joints/<name>``.

    Attributes
    ----------
    name
        Name of the stream.
    """

    name: str

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Yield samples of the stream until the source stops."""
        with subscribed(source, source.component.keys.stream("joints", self.name)) as received:
            yield from _samples(received, source, _from_wire)


@dataclass(frozen=True)
class RosTopic:
    """Reads ``sensor_msgs/msg/JointState`` live from a ROS 2 network that uses rmw_zenoh.

    Attributes
    ----------
    topic, domain
        ROS topic and domain id.
    settings
        How to connect to the router of that network; None: use the session of the source.
    """

    topic: str
    domain: int = 0
    settings: SessionSettings | None = None

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Yield samples of the topic until the source stops."""
        with subscribed(source, ros_key(self.topic, self.domain), self.settings) as received:
            yield from _samples(received, source, _from_ros)


@dataclass(frozen=True)
class LogPlayback:
    """Plays the samples of a log at the times they were recorded.

    Attributes
    ----------
    samples
        The samples of the log, in order.
    speed
        Recorded seconds per second of playback, above 0.
    original_stamps
        Keep the stamps of the log; else a sample gets the wall clock time at which it is played.
    """

    samples: Iterable[JointSample]
    speed: float = 1.0
    original_stamps: bool = False

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Yield samples when they are due until the log ends or the source stops."""
        begin_wall, begin = time.time_ns(), time.monotonic()
        first: int | None = None
        for sample in self.samples:
            first = sample.stamp_ns if first is None else first
            elapsed = (sample.stamp_ns - first) / self.speed
            if source.stop.wait(max(0.0, begin + elapsed * 1e-9 - time.monotonic())):
                return
            stamp = sample.stamp_ns if self.original_stamps else begin_wall + round(elapsed)
            yield JointSample(stamp, sample.names, sample.positions)


def _samples(received: Received, source: SourcePublisher, read: _Read) -> Iterator[JointSample | None]:
    """Read what is received; what is malformed is counted and left out."""
    for arrival in received:
        if arrival is None:
            yield None
            continue
        try:
            yield read(*arrival)
        except DecodeError as error:
            source.reject(error.reason)
        except InputError:
            source.reject("malformed")


def _from_wire(key: str, payload: bytes, _received_ns: int) -> JointSample:
    message = cast("JointStates", decode_on(key, payload))
    return joint_sample(message.stamp_ns, message.names, message.positions)


def _from_ros(_key: str, payload: bytes, received_ns: int) -> JointSample:
    return from_message(decode_message(payload), received_ns)
