"""The layout for Foxglove."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


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
