"""Publishes what a ROS 2 topic says of features in a scene."""

from dataclasses import dataclass
from typing import Unpack

from comotion_schemas.component import Where
from comotion_schemas.ros_types import topic_key
from comotion_schemas.transport import SessionSettings

from ..errors import InputError
from ..runtime import SourcePublisher
from .convert import Converter, Observed, kind_of


@dataclass(frozen=True, kw_only=True)
class Ros2Source:
    """What to follow.

    Attributes
    ----------
    topic, domain
        ROS topic and domain id.
    pattern
        Frames or bodies to take, with ``*`` and ``?``.
    frame
        Frame id that the positions must be in; None: that of the first message.
    ros
        How to connect to the router of the ROS network; None: that of the scene.
    """

    topic: str
    domain: int = 0
    pattern: str = "*"
    frame: str | None = None
    ros: SessionSettings | None = None


def run(
    followed: Ros2Source,
    *,
    name: str = "ros2",
    space: str = "world",
    **where: Unpack[Where],
) -> None:
    """Publish the features of a topic until a signal arrives.

    Raises
    ------
    ValueError
        If a name is not valid.
    """
    source = SourcePublisher(
        name,
        space=space,
        unit="m",
        dim=3,
        drop_invalid=True,
        message=f"ROS topic {followed.topic}",
        **where,
    )
    with source:
        arrivals = source.receive(topic_key(followed.topic, followed.domain), followed.ros)
        source.ready()
        relay = _Relay(source, followed)
        for arrival in arrivals:
            if arrival is not None:
                relay.take(*arrival)


class _Relay:
    """Converts and publishes; what cannot be used is counted, and said once."""

    def __init__(self, source: SourcePublisher, followed: Ros2Source) -> None:
        self._source, self._frame = source, followed.frame
        self._converter = Converter(followed.pattern)

    def take(self, key: str, raw: bytes, received_ns: int) -> None:
        kind = kind_of(key)
        if kind is None:
            self._source.reject("schema", f"{key.split('/')[-2]} is not a type that can be followed")
            return
        try:
            observations = self._converter.convert(kind, raw, received_ns)
        except InputError as error:
            self._source.reject("malformed", str(error))
            return
        self._source.name_features({number: name for name, number in self._converter.ids.items()})
        for observed in observations:
            self._publish(observed)

    def _publish(self, observed: Observed) -> None:
        self._frame = self._frame or observed.frame
        if observed.frame != self._frame:
            self._source.reject("space-mismatch", f"frame {observed.frame!r} is not {self._frame!r}")
            return
        try:
            self._source.observe(
                ids=observed.ids,
                positions=observed.positions,
                quaternions=observed.quaternions,
                stamp_ns=observed.stamp_ns,
            )
        except ValueError as error:
            self._source.reject("malformed", str(error).partition("\n")[0])
