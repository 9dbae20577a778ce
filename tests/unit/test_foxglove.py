"""Live Foxglove: a client of its WebSocket protocol sees the topics of a scene, and reads a message."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from comotion_clients.viewing.process import ViewOptions  # noqa: F401 - the display is one of its displays
from comotion_schemas.colours import Palette

from .test_joint_clients import DOOR, DRAWER, FREE, update

websockets = pytest.importorskip("websockets.sync.client")
foxglove = pytest.importorskip("foxglove")


def test_a_client_reads_the_numbers_of_an_update():
    from comotion_clients.foxglove.server import FoxgloveDisplay

    with FoxgloveDisplay(0) as display:
        # A first message makes the channels known.
        display.on_message(update([DOOR, DRAWER]), 0.0, 1)
        with websockets.connect(display.url, subprotocols=["foxglove.sdk.v1"]) as client:
            channels = {}
            while "/numbers" not in channels:
                told = json.loads(client.recv(timeout=30))
                channels |= {c["topic"]: c for c in told.get("channels", [])}
            assert channels["/joints/world"]["schemaName"] == "foxglove.SceneUpdate"
            wanted = {"id": 7, "channelId": channels["/numbers"]["id"]}
            client.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
            message = b""
            while not isinstance(message, bytes) or not message.startswith(b"\x01"):
                # The subscription is at work some time after it was sent.
                display.on_message(update([DOOR, DRAWER]), 0.0, 2)
                try:
                    message = client.recv(timeout=0.2)
                except TimeoutError:
                    continue
    _, subscription, log_ns = struct.unpack_from("<BIQ", message)
    assert (subscription, log_ns) == (7, 2)
    assert json.loads(message[13:])["hypotheses"] == len(update([]).hypotheses)


def test_a_port_in_use_is_an_error_of_the_system():
    from comotion_clients.foxglove.server import FoxgloveDisplay

    with FoxgloveDisplay(0) as display, pytest.raises(OSError, match="no server on"):
        FoxgloveDisplay(int(display.url.rpartition(":")[2]))


def test_joints_are_drawn_with_their_words():
    from comotion_clients.foxglove import messages

    drawn = messages.joints(update([DOOR, DRAWER, FREE]), "world", 1.0, Palette(), {2: "door", 1: "shelf"})
    assert b"door turns on shelf, 0 to 69" in drawn.encode()
    assert messages.joints(update([FREE]), "world", 1.0, Palette(), {}) is None


def panels(node: object) -> Iterator[dict[str, Any]]:
    """Configurations of all panels of a layout."""
    if isinstance(node, dict) and node.get("type") == "panel":
        yield node["config"]
    for inner in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from panels(inner)


def test_the_layout_shows_what_the_sample_holds():
    reading = pytest.importorskip("mcap.reader")
    samples = Path(__file__).parents[2] / "docs" / "samples"
    with (samples / "3d_5.mcap").open("rb") as file:
        reader = reading.make_reader(file)
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
        numbers = [json.loads(one.data) for *_, one in reader.iter_messages(topics=["/numbers"])][-1]
    shown = set()
    for config in panels(json.loads((samples / "foxglove-layout.json").read_text())):
        shown |= {*config.get("topics", ()), config.get("topicToRender", "/events")}
        for path in config.get("paths", ()):
            topic, _, value = path["value"].partition(".")
            assert topic == "/numbers"
            assert value in numbers
    # Other recordings have joints.
    assert shown == topics - {"/numbers", "/tf", "/hypotheses/world"} | {"/joints/world"}
