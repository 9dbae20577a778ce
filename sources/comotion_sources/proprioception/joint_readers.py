"""Joint readers: a stream of the scene, a ROS 2 topic over Zenoh, or a log -> joint samples.

A reader yields samples as they arrive. While none arrives it yields None every 0.1 s, so that the
caller can send samples that it holds back. Malformed samples are counted and left out.
"""

import queue
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

import zenoh

from comotion_schemas import DecodeError, JointStates, decode
from comotion_schemas.messages import RejectionReason
from comotion_schemas.transport import SessionSettings, declare_subscriber, open_session

from ..runtime import SourcePublisher
from .cdr import decode_message, from_message, ros_key
from .samples import JointSample, SampleError, joint_sample

_QUEUE_CAPACITY = 2000
"""Samples: 4 s of a robot that reports at 500 Hz."""
_IDLE_S = 0.1
"""Interval between two None while no sample arrives, s."""


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
        component = source.component
        received = _Queue(source, _from_wire(self.name))
        key = component.keys.stream("joints", self.name)
        subscriber = declare_subscriber(component.session, key, "joints", received.receive)
        try:
            yield from received.samples()
        finally:
            subscriber.undeclare()


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
        received = _Queue(source, _from_ros)
        with ExitStack() as stack:
            session = source.component.session
            if self.settings is not None:
                session = stack.enter_context(open_session(self.settings))
            subscriber = session.declare_subscriber(ros_key(self.topic, self.domain), received.receive)
            stack.callback(subscriber.undeclare)
            yield from received.samples()


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


class _Queue:
    """Takes payloads from Zenoh's thread without blocking it; drops new ones when full, as ``lost``."""

    def __init__(self, source: SourcePublisher, read: Callable[[bytes, int], JointSample]) -> None:
        self._source, self._read = source, read
        self._queue: queue.SimpleQueue[tuple[bytes, int]] = queue.SimpleQueue()

    def receive(self, sample: zenoh.Sample) -> None:
        if self._queue.qsize() >= _QUEUE_CAPACITY:
            self._source.count("lost")
            return
        self._queue.put((bytes(sample.payload), time.time_ns()))

    def samples(self) -> Iterator[JointSample | None]:
        while not self._source.stop.is_set():
            try:
                payload, received_ns = self._queue.get(timeout=_IDLE_S)
            except queue.Empty:
                yield None
                continue
            try:
                yield self._read(payload, received_ns)
            except DecodeError as error:
                self._source.reject(error.reason)
            except SampleError:
                self._source.reject(_MALFORMED)


_MALFORMED: RejectionReason = "malformed"


def _from_wire(name: str) -> Callable[[bytes, int], JointSample]:
    def read(payload: bytes, _received_ns: int) -> JointSample:
        message = decode(payload)
        if not isinstance(message, JointStates):
            raise DecodeError("schema", f"expected JointStates, got {type(message).__name__}")
        if message.source != name:
            raise DecodeError("source-mismatch", f"source {message.source!r} on the key of {name!r}")
        return joint_sample(message.stamp_ns, message.names, message.positions)

    return read


def _from_ros(payload: bytes, received_ns: int) -> JointSample:
    return from_message(decode_message(payload), received_ns)
