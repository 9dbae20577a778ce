"""Publishes what a ROS 2 topic says of features in a scene."""

from collections.abc import Iterable
from typing import Unpack

from comotion_schemas.component import Where
from comotion_schemas.ros_types import topic_key
from comotion_schemas.transport import SessionSettings

from ..errors import InputError
from ..received import Arrival
from ..runtime import SourcePublisher
from .convert import Converter, kind_of


def run(
    topic: str,
    *,
    domain: int = 0,
    pattern: str = "*",
    frame: str | None = None,
    ros: SessionSettings | None = None,
    name: str = "ros2",
    space: str = "world",
    **where: Unpack[Where],
) -> None:
    """Publish the features of a topic until a signal arrives.

    Parameters
    ----------
    topic, domain
        ROS topic and domain id.
    pattern
        Frames or bodies to take, with ``*`` and ``?``.
    frame
        Frame id that the positions must be in; None: that of the first message.
    ros
        How to connect to the router of the ROS network; None: that of the scene.
    name, space
        Name of the source; coordinate space of its features.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If a name is not valid.
    """
    text = f"ROS topic {topic}"
    with SourcePublisher(
        name, space=space, unit="m", dim=3, drop_invalid=True, message=text, **where
    ) as source:
        arrivals = source.receive(topic_key(topic, domain), ros)
        source.ready()
        relay(arrivals, source, Converter(pattern), frame)


def relay(
    arrivals: Iterable[Arrival | None], source: SourcePublisher, converter: Converter, frame: str | None
) -> None:
    """Convert and publish what arrives; what cannot be used is counted, and said once."""
    for key, raw, received_ns in filter(None, arrivals):
        kind = kind_of(key)
        if kind is None:
            source.reject("schema", f"{key.split('/')[-2]} is not a type that can be followed")
            continue
        try:
            observations = converter.convert(kind, raw, received_ns)
        except InputError as error:
            source.reject("malformed", str(error))
            continue
        source.name_features({number: name for name, number in converter.ids.items()})
        for observed in observations:
            frame = frame or observed.frame
            if observed.frame != frame:
                source.reject("space-mismatch", f"frame {observed.frame!r} is not {frame!r}")
                continue
            try:
                source.observe(**observed.columns)
            except ValueError as error:
                source.reject("malformed", str(error).partition("\n")[0])
