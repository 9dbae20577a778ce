"""`comotion ros2` and `source ros2` over a real router; the other side is Zenoh and rosbags alone."""

import queue
import struct
from typing import Any

import numpy as np
import pytest
import zenoh

pytest.importorskip("rosbags", reason="needs the extra ros")

from rosbags.typesys import Stores, get_typestore

from comotion_schemas import Keys, encode
from comotion_schemas.transport import declare_publisher

from ..unit.test_ros2 import PUBLISHED, reader, update
from .tracker import until_heard

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


def header(types: Any, frame: str, seconds: int) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=0)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def transforms(types: Any, name: str, x: float, seconds: int) -> Any:
    """A message of tf with one frame in ``map``."""
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=1.0, w=0.0)
    place = types["geometry_msgs/msg/Vector3"](x=x, y=2.0, z=3.0)
    return types["tf2_msgs/msg/TFMessage"](
        transforms=[
            types["geometry_msgs/msg/TransformStamped"](
                header=header(types, "map", seconds),
                child_frame_id=name,
                transform=types["geometry_msgs/msg/Transform"](translation=place, rotation=turn),
            )
        ]
    )


def cloud(types: Any, points: list[tuple[float, float, float, int]], seconds: int) -> Any:
    """A cloud in ``map`` whose points have ids."""
    field = types["sensor_msgs/msg/PointField"]
    kinds = {"x": 7, "y": 7, "z": 7, "id": 6}
    return types["sensor_msgs/msg/PointCloud2"](
        header=header(types, "map", seconds),
        height=1,
        width=len(points),
        fields=[
            field(name=name, offset=4 * k, datatype=kind, count=1)
            for k, (name, kind) in enumerate(kinds.items())
        ],
        is_bigendian=False,
        point_step=16,
        row_step=16 * len(points),
        data=np.frombuffer(b"".join(struct.pack("<fffI", *point) for point in points), np.uint8),
        is_dense=True,
    )


def test_messages_of_a_node_become_observations(start, endpoint, session, listen):
    store = get_typestore(Stores.ROS2_JAZZY)
    batches = {name: listen(session, Keys().stream("obs", name), "obs") for name in ("frames", "points")}
    at = ("--domain", DOMAIN, "--connect", endpoint)
    start("source", "ros2", "/tf", "--match", "cup*", "--name", "frames", *at)
    start("source", "ros2", "/tracker/points", "--name", "points", *at)

    def send(topic: str, kind: str, *messages: Any) -> None:
        package, middle, name = kind.split("/")
        key = f"{DOMAIN}{topic}/{package}::{middle}::dds_::{name}_/{store.hash_rihs01(kind)}"
        publisher = until_heard(session.declare_publisher(key))
        for sequence, message in enumerate(messages, 1):
            payload = message if isinstance(message, bytes) else bytes(store.serialize_cdr(message, kind))
            publisher.put(payload, attachment=struct.pack("<qqB", sequence, 0, 16) + bytes(16))
        publisher.undeclare()

    types = store.types
    send("/tf", "tf2_msgs/msg/TFMessage", transforms(types, "robot", 9, 4), transforms(types, "cup", 1, 5))
    seen = cloud(types, [(1, 2, 3, 70), (4, 5, 6, 71), (np.nan, 0, 0, 72)], 6)
    send("/tracker/points", "sensor_msgs/msg/PointCloud2", b"\0\1\0\0broken", seen)
    frames, points = (batches[name].until(lambda b: len(b.ids)) for name in ("frames", "points"))
    assert (frames.stamp_ns, frames.space, frames.unit) == (5 * 10**9, "world", "m")
    assert frames.positions.tolist() == [[1, 2, 3]]
    assert frames.quaternions.tolist() == [[0, 0, 1, 0]]
    assert (points.stamp_ns, points.ids.tolist()) == (6 * 10**9, [70, 71])
    assert points.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
