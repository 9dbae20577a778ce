"""The client that passes a scene on to ROS 2: over rmw_zenoh, into a bag, or both."""

import logging
import secrets
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import zenoh

from comotion_schemas import DEFAULT_SCENE, HypothesisUpdate, Status
from comotion_schemas.component import Component, StatusFields, viewer
from comotion_schemas.naming import Names
from comotion_schemas.transport import SessionSettings, open_session

from ..inbox import Closed
from ..subscription import Subscription
from .messages import Converter
from .names import Node, attachment, topic_chunk, topic_key
from .types import to_cdr, type_hash

_POLL_S = 0.2
_log = logging.getLogger(__name__)


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
    ready_file: Path | None = None
    names: Names = field(default_factory=dict)


def run(
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    options: Ros2Options | None = None,
) -> Counter[str]:
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
    converter = Converter(scene, options.names)
    presence = viewer(
        "ros2",
        scene,
        settings,
        status=lambda: StatusFields(counters={"messages": sent.total()}),
        ready_file=options.ready_file,
    )
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
            outputs.append(stack.enter_context(Network(session, options.domain, scene, converter.kinds())))
        updates = stack.enter_context(Subscription(component.session, HypothesisUpdate, scene))
        statuses = stack.enter_context(Subscription(component.session, Status, scene))
        component.ready()
        _pass_on(component, updates, statuses, converter, outputs, sent, options.duration)
    return sent


def _pass_on(
    component: Component,
    updates: Subscription[HypothesisUpdate],
    statuses: Subscription[Status],
    converter: Converter,
    outputs: list[Any],
    sent: Counter[str],
    duration: float | None,
) -> None:
    end = None if duration is None else time.monotonic() + duration
    while not component.stop.is_set() and (end is None or time.monotonic() < end):
        try:
            update = updates.get(_POLL_S)
        except TimeoutError:
            continue
        except Closed:
            return
        for _, status in statuses.drain():
            converter.names.on_status(status)
        for topic, kind, message in converter.convert(update):
            raw = to_cdr(message, kind)
            for output in outputs:
                output.write(topic, kind, raw, update.published_ns)
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
