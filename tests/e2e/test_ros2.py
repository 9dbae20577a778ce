"""`comotion ros2` and `source ros2` over a real router; the other side is Zenoh and rosbags alone."""

import queue
import struct

import pytest
import zenoh

pytest.importorskip("rosbags", reason="needs the extra ros")


from comotion_schemas import Keys, encode
from comotion_schemas.transport import declare_publisher

from ..unit.test_ros2 import PUBLISHED, reader, update
from ..unit.test_ros2_source import CLOUD, TF, cloud, tf, transform
from .waiting import until_heard

DOMAIN = 17


def test_every_topic_arrives_as_ros_sends_it(start, endpoint, session):
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
    store = reader()
    for key, sample in seen.items():
        *topic, dds, hash_ = key.split("/")[1:]
        package, middle, _, name = dds.rstrip("_").split("::")
        kind = f"{package}/{middle}/{name}"
        raw = sample.attachment.to_bytes()
        sequence, _stamp, length = struct.unpack("<qqB", raw[:17])
        assert (sequence >= 1, length, len(raw)) == (True, 16, 33)
        assert hash_ == PUBLISHED[kind], topic
        assert store.deserialize_cdr(sample.payload.to_bytes(), kind)
    tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")]
    assert sum("/NN/" in token for token in tokens) == 1
    assert sum("/MP/" in token for token in tokens) == 6
    subscriber.undeclare()
    publisher.undeclare()
    assert process.interrupt() == 0
    assert "/tf: 1" in process.output


def test_messages_of_a_node_become_observations(start, endpoint, session, listen):
    batches = {name: listen(session, Keys().stream("obs", name), "obs") for name in ("frames", "points")}
    at = ("--domain", DOMAIN, "--connect", endpoint)
    start("source", "ros2", "/tf", "--match", "cup*", "--name", "frames", *at)
    start("source", "ros2", "/tracker/points", "--name", "points", *at)

    def send(topic, kind, *payloads):
        package, middle, name = kind.split("/")
        key = f"{DOMAIN}{topic}/{package}::{middle}::dds_::{name}_/{PUBLISHED[kind]}"
        publisher = until_heard(session.declare_publisher(key))
        for sequence, payload in enumerate(payloads, 1):
            publisher.put(payload, attachment=struct.pack("<qqB", sequence, 0, 16) + bytes(16))
        publisher.undeclare()

    send("/tf", TF, *(tf(transform(name, x, "map")) for name, x in (("robot", 9.0), ("cup", 1.0))))
    send("/tracker/points", CLOUD, b"\0\1\0\0broken", cloud())
    frames, points = (batches[name].until(lambda b: len(b.ids)) for name in ("frames", "points"))
    assert (frames.stamp_ns, frames.space, frames.unit) == (5 * 10**9 + 7, "world", "m")
    assert frames.positions.tolist() == [[1, 0, 1]]
    assert frames.quaternions.tolist() == [[0, 0, 0, 1]]
    assert (points.stamp_ns, points.ids.tolist()) == (5 * 10**9 + 7, [10, 11, 12])
    assert points.positions.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
