"""`comotion ros2`: a subscriber that shares no code with it receives, from a real router, every topic."""

import queue
import struct
from collections.abc import Callable

import pytest
import zenoh

pytest.importorskip("rosbags", reason="needs the extra ros")

from rosbags.typesys import Stores, get_typestore

from comotion_schemas import Keys, encode
from comotion_schemas.transport import declare_publisher

from ..unit.test_ros2 import PUBLISHED, update

pytestmark = pytest.mark.e2e
DOMAIN = 17


def test_every_topic_arrives_as_ros_sends_it(start: Callable, endpoint: str, session: zenoh.Session) -> None:
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    # What a node of rmw_zenoh declares: a plain subscriber on the key of the topic, with any hash.
    subscriber = session.declare_subscriber(f"{DOMAIN}/**", arrived.put)
    publisher = declare_publisher(session, Keys("my-lab").hypotheses, "hypotheses")
    publisher.put(encode(update()))
    process = start("ros2", "--scene", "my-lab", "--connect", endpoint, "--domain", DOMAIN)
    process.wait_ready()
    seen: dict[str, zenoh.Sample] = {}
    while len(seen) < 6:
        sample = arrived.get(timeout=60)
        seen[str(sample.key_expr)] = sample
    store = get_typestore(Stores.ROS2_JAZZY)
    for key, sample in seen.items():
        *topic, dds, hash_ = key.split("/")[1:]
        package, middle, _, name = dds.rstrip("_").split("::")
        kind = f"{package}/{middle}/{name}"
        raw = sample.attachment.to_bytes()
        sequence, _stamp, length = struct.unpack("<qqB", raw[:17])
        assert (sequence >= 1, length, len(raw)) == (True, 16, 33)
        if kind in PUBLISHED:
            assert hash_ == PUBLISHED[kind], topic
            assert store.deserialize_cdr(sample.payload.to_bytes(), kind)
    tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")]
    assert sum("/NN/" in token for token in tokens) == 1
    assert sum("/MP/" in token for token in tokens) == 6
    subscriber.undeclare()
    publisher.undeclare()
    process.interrupt()
    assert process.wait() == 0
    assert "/tf: 1" in process.output
