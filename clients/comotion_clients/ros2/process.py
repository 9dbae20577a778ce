"""The client that passes a scene on to ROS 2: over rmw_zenoh, or into a bag."""

import secrets
import time
from collections import Counter
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any, Unpack

import zenoh

from comotion_schemas import HypothesisUpdate, Status
from comotion_schemas.component import StatusFields, Where, viewer
from comotion_schemas.naming import Names
from comotion_schemas.ros_types import topic_key
from comotion_schemas.transport import SessionSettings, open_session

from ..feed import SceneFeed
from .messages import Converter
from .types import Node, attachment, dds_name, definition, to_cdr, topic_chunk, type_hash

_POLL_S = 0.2


def run(
    *,
    domain: int = 0,
    ros: SessionSettings | None = None,
    bag: Path | None = None,
    duration: float | None = None,
    names: Names | None = None,
    **where: Unpack[Where],
) -> Counter[str]:
    """Pass a scene on until a signal arrives; returns the number of messages by topic.

    `domain` is the ROS domain id, `ros` how to connect to the router of the ROS network (None: that of the
    scene). With a `bag`, that is written instead. `duration` is in s, None: until stopped; `names` are those
    of hypotheses by id.

    Raises
    ------
    ImportError
        If rosbags (or for a bag, mcap) is not installed.
    OSError
        If the bag exists or cannot be written.
    """
    sent = Counter[str]()
    presence = viewer("ros2", status=lambda: StatusFields(counters={"messages": sent.total()}), **where)
    converter = Converter(presence.scene, names)
    with ExitStack() as stack:
        output: Any = None if bag is None else stack.enter_context(Bag(bag))
        component = stack.enter_context(presence)
        if output is None:
            session = component.session if ros is None else stack.enter_context(open_session(ros))
            output = stack.enter_context(Network(session, domain, component.scene, converter.kinds()))
        kinds = (Status, HypothesisUpdate)
        feed = stack.enter_context(SceneFeed(component.session, component.scene, kinds))
        component.ready()
        end = float("inf") if duration is None else time.monotonic() + duration
        while not component.stop.is_set() and (left := end - time.monotonic()) > 0:
            feed.of[HypothesisUpdate].wait(min(_POLL_S, left))
            for received, *_ in feed.messages():
                if isinstance(received, Status):
                    converter.names.on_status(received)
                elif isinstance(received, HypothesisUpdate):
                    for topic, kind, message in converter.convert(received):
                        output.write(topic, kind, to_cdr(message, kind), received.published_ns)
                        sent[topic] += 1
    return sent


class Network(ExitStack):
    """Publishers of a node in a network of rmw_zenoh; a context manager.

    The `session` is connected to the router of the network, as a client; `domain` is the ROS domain id, the
    `scene` is in the name of the node, and `kinds` has the type of each topic.
    """

    def __init__(self, session: zenoh.Session, domain: int, scene: str, kinds: dict[str, str]) -> None:
        super().__init__()
        node = Node(domain, str(session.info.zid()), f"comotion_{topic_chunk(scene)}")
        self._publishers: dict[str, Any] = {}
        self._sequence = Counter[str]()
        self._gids = {topic: secrets.token_bytes(16) for topic in kinds}
        tokens = [node.token()]
        for number, (topic, kind) in enumerate(kinds.items(), 1):
            hash_ = type_hash(kind)
            key, drop = topic_key(topic, domain, dds_name(kind), hash_), zenoh.CongestionControl.DROP
            self._publishers[topic] = session.declare_publisher(key, congestion_control=drop)
            self.callback(self._publishers[topic].undeclare)
            tokens.append(node.publisher_token(number, topic, kind, hash_))
        for token in tokens:
            # The callback keeps a reference: a token without one disappears.
            self.callback(session.liveliness().declare_token(token).undeclare)

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:  # noqa: ARG002
        """Publish a message; the time of sending is now."""
        self._sequence[topic] += 1
        number = attachment(self._sequence[topic], time.time_ns(), self._gids[topic])
        self._publishers[topic].put(raw, attachment=number)


class Bag(ExitStack):
    """Writes messages to a new MCAP file, for ``ros2 bag`` and Foxglove; a context manager.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        from ..recording.file import Definition, TopicWriter  # needs the extra `record`

        super().__init__()
        self._writer = TopicWriter(self.enter_context(path.open("xb")), profile="ros2")
        self.callback(self._writer.finish)
        self._definition = cache(lambda kind: Definition(kind, "ros2msg", definition(kind).encode()))

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:
        """Append a message in CDR."""
        channel = self._writer.channel(topic, self._definition(kind), "cdr")
        self._writer.add_message(channel, stamp_ns, raw, stamp_ns)
