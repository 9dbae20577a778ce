"""Where joint readings come from: a scene on the wire, a ROS 2 network on Zenoh, or a log played back.

An inlet is entered with the source that publishes, and yields readings as they come; None now and
then while nothing comes, so that what waits can be sent. What is malformed is counted and left out.
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

_WAITING = 2000
_IDLE_S = 0.1


class Inlet(Protocol):
    """A stream of readings."""

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Yield readings until the stream ends or the source is asked to stop."""
        ...


@dataclass(frozen=True)
class SceneJoints:
    """Joint states of the same scene: ``joints/<name>``, whoever publishes them.

    Attributes
    ----------
    name
        Name of the stream.
    """

    name: str

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Follow the stream until the source stops."""
        component = source.component
        inbox = _Inbox(source, _from_wire(self.name))
        key = component.keys.stream("joints", self.name)
        subscriber = declare_subscriber(component.session, key, "joints", inbox.receive)
        try:
            yield from inbox.samples()
        finally:
            subscriber.undeclare()


@dataclass(frozen=True)
class RosTopic:
    """``sensor_msgs/msg/JointState`` live from a Zenoh network of rmw_zenoh.

    Attributes
    ----------
    topic, domain
        ROS topic and domain id.
    settings
        Where that network's router is; None: the session of the source.
    """

    topic: str
    domain: int = 0
    settings: SessionSettings | None = None

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Follow the topic until the source stops."""
        inbox = _Inbox(source, _from_ros)
        with ExitStack() as stack:
            session = source.component.session
            if self.settings is not None:
                session = stack.enter_context(open_session(self.settings))
            subscriber = session.declare_subscriber(ros_key(self.topic, self.domain), inbox.receive)
            stack.callback(subscriber.undeclare)
            yield from inbox.samples()


@dataclass(frozen=True)
class Playback:
    """A log played at its own pace.

    Attributes
    ----------
    samples
        The readings of the log.
    speed
        Recorded seconds per second.
    original_stamps
        Keep the log's own stamps; else they are those of the wall clock when a reading is due.
    """

    samples: Iterable[JointSample]
    speed: float = 1.0
    original_stamps: bool = False

    def readings(self, source: SourcePublisher) -> Iterator[JointSample | None]:
        """Play until the log ends or the source stops."""
        begin_wall, begin = time.time_ns(), time.monotonic()
        first: int | None = None
        for sample in self.samples:
            first = sample.stamp_ns if first is None else first
            elapsed = (sample.stamp_ns - first) / self.speed
            if source.stop.wait(max(0.0, begin + elapsed * 1e-9 - time.monotonic())):
                return
            stamp = sample.stamp_ns if self.original_stamps else begin_wall + round(elapsed)
            yield JointSample(stamp, sample.names, sample.positions)


class _Inbox:
    """Takes payloads from Zenoh's thread, never blocking it; what does not fit is counted as lost."""

    def __init__(self, source: SourcePublisher, read: Callable[[bytes, int], JointSample]) -> None:
        self._source, self._read = source, read
        self._queue: queue.SimpleQueue[tuple[bytes, int]] = queue.SimpleQueue()

    def receive(self, sample: zenoh.Sample) -> None:
        if self._queue.qsize() >= _WAITING:
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
            raise DecodeError("schema", f"{type(message).__name__} where JointStates belong")
        if message.source != name:
            raise DecodeError("source-mismatch", f"source {message.source!r} on the key of {name!r}")
        return joint_sample(message.stamp_ns, message.names, message.positions)

    return read


def _from_ros(payload: bytes, received_ns: int) -> JointSample:
    return from_message(decode_message(payload), received_ns)
