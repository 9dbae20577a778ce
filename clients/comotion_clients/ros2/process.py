"""The client that passes a scene on to ROS 2: over rmw_zenoh, into a bag, or both."""

import secrets
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, Unpack

import zenoh

from comotion_schemas import HypothesisUpdate, Status
from comotion_schemas.component import StatusFields, Where, viewer
from comotion_schemas.naming import Names
from comotion_schemas.transport import SessionSettings, open_session

from ..feed import SceneFeed
from .messages import Converter
from .names import Node, attachment, topic_chunk, topic_key
from .types import to_cdr, type_hash

_POLL_S = 0.01


@dataclass(frozen=True, kw_only=True)
class Ros2Options:
    """Options of the client.

    Attributes
    ----------
    domain
        ROS domain id.
    ros
        How to connect to the router of the ROS network; None: that of the scene.
    network
        Publish into the network.
    bag
        Bag to write; None: none.
    duration
        s; None: until stopped.
    names
        Names of hypotheses by id.
    """

    domain: int = 0
    ros: SessionSettings | None = None
    network: bool = True
    bag: Path | None = None
    duration: float | None = None
    names: Names = field(default_factory=dict)


def run(options: Ros2Options | None = None, **where: Unpack[Where]) -> Counter[str]:
    """Pass a scene on until a signal arrives; returns the number of messages by topic.

    Raises
    ------
    ImportError
        If rosbags (or for a bag, mcap) is not installed.
    OSError
        If the bag exists or cannot be written.
    ValueError
        If the name of the scene is not valid.
    """
    options, sent = options or Ros2Options(), Counter[str]()
    presence = viewer("ros2", status=lambda: StatusFields(counters={"messages": sent.total()}), **where)
    converter = Converter(presence.scene, options.names)
    with ExitStack() as stack:
        outputs: list[Any] = []
        if options.bag is not None:
            from .bag import Bag

            outputs.append(stack.enter_context(Bag(options.bag)))
        component = stack.enter_context(presence)
        if options.network:
            session = component.session
            if options.ros is not None:
                session = stack.enter_context(open_session(options.ros))
            network = Network(session, options.domain, component.scene, converter.kinds())
            outputs.append(stack.enter_context(network))
        kinds: dict[type[Any], int | None] = {Status: None, HypothesisUpdate: None}
        feed = stack.enter_context(SceneFeed(component.session, component.scene, kinds))
        component.ready()
        end = float("inf") if options.duration is None else time.monotonic() + options.duration
        while not component.stop.wait(_POLL_S) and time.monotonic() < end:
            _pass_on(feed, converter, outputs, sent)
    return sent


def _pass_on(feed: SceneFeed, converter: Converter, outputs: list[Any], sent: Counter[str]) -> None:
    """Convert what has arrived, and write it to the outputs."""
    for received, *_ in feed.messages():
        if isinstance(received, Status):
            converter.names.on_status(received)
        elif isinstance(received, HypothesisUpdate):
            for topic, kind, message in converter.convert(received):
                raw = to_cdr(message, kind)
                for output in outputs:
                    output.write(topic, kind, raw, received.published_ns)
                sent[topic] += 1


class Network:
    """Publishers of a node in a network of rmw_zenoh; a context manager.

    Parameters
    ----------
    session
        Connected to the router of the network, as a client.
    domain, scene
        ROS domain id, and the scene for the name of the node.
    kinds
        Type of each topic.
    """

    def __init__(self, session: zenoh.Session, domain: int, scene: str, kinds: dict[str, str]) -> None:
        self._session, self._domain, self._kinds = session, domain, kinds
        self._node = Node(domain, str(session.info.zid()), f"comotion_{topic_chunk(scene)}")
        self._publishers: dict[str, Any] = {}
        self._sequence = Counter[str]()
        self._gids = {topic: secrets.token_bytes(16) for topic in kinds}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            # A token that is not referenced disappears.
            self._tokens = [self._token(stack, self._node.token())]
            for number, (topic, kind) in enumerate(self._kinds.items(), 1):
                hash_ = type_hash(kind)
                publisher = self._session.declare_publisher(
                    topic_key(self._domain, topic, kind, hash_),
                    congestion_control=zenoh.CongestionControl.DROP,
                )
                stack.callback(publisher.undeclare)
                self._publishers[topic] = publisher
                self._tokens.append(
                    self._token(stack, self._node.publisher_token(number, topic, kind, hash_))
                )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:  # noqa: ARG002
        """Publish a message; the time of sending is now."""
        self._sequence[topic] += 1
        number = attachment(self._sequence[topic], time.time_ns(), self._gids[topic])
        self._publishers[topic].put(raw, attachment=number)

    def _token(self, stack: ExitStack, key: str) -> Any:
        token = self._session.liveliness().declare_token(key)
        stack.callback(token.undeclare)
        return token
