"""Updates as ROS 2 messages, decoded by rosbags with type texts of its own, and a bag by another reader."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_schemas import UNDETERMINED, Box, Joint, Pose, SourceRef, Twist

from .. import builders
from ..builders import SESSION, S, hypothesis

pytest.importorskip("rosbags", reason="needs the extra ros")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from comotion_clients.ros2.messages import Converter
from comotion_clients.ros2.types import (
    CLOUD,
    DETECTIONS,
    JOINTS,
    MARKERS,
    ODOMETRY,
    TF,
    Node,
    attachment,
    dds_name,
    to_cdr,
    topic_chunk,
    type_hash,
)
from comotion_schemas.ros_types import topic_key

# As ROS 2 Jazzy and vision_msgs 4.1.1 publish them.
PUBLISHED = {
    TF: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    CLOUD: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    ODOMETRY: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    MARKERS: "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    JOINTS: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    DETECTIONS: "RIHS01_793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018",
}
# Written down here again, so that the test shares nothing with the code.
VISION = """vision_msgs/msg/ObjectHypothesis: string class_id; float64 score
vision_msgs/msg/ObjectHypothesisWithPose: ObjectHypothesis hypothesis; geometry_msgs/PoseWithCovariance pose
vision_msgs/msg/BoundingBox3D: geometry_msgs/Pose center; geometry_msgs/Vector3 size
vision_msgs/msg/Detection3D: std_msgs/Header header; ObjectHypothesisWithPose[] results; \
BoundingBox3D bbox; string id
vision_msgs/msg/Detection3DArray: std_msgs/Header header; Detection3D[] detections"""


def reader():
    store = get_typestore(Stores.ROS2_JAZZY)
    for line in VISION.splitlines():
        name, _, fields = line.partition(": ")
        store.register(get_types_from_msg(fields.replace("; ", "\n"), name))
    return store


def update(count=6, stamp_ns=5 * S + 250):
    """A body that turns about z above a background at rest, a feature of neither, and one of an image."""
    half = float(np.sqrt(0.5))
    body = hypothesis(
        7,
        size=2,
        centroid=[1.0, 2.0, 0.5],
        pose=Pose(translation=[0.1, 0.2, 0.3], rotation=[0.0, 0.0, half, half]),
        twist=Twist(linear=[0.0, 1.0, 0.0], angular=[0.0, 0.0, 2.0]),
        box=Box(center=[1.5, 2.0, 0.5], half=[0.3, 0.2, 0.1], rotation=[0.0, 0.0, half, half]),
    )
    rest = hypothesis(1, size=2, state="static")
    image = hypothesis(9, space="cam/pixels", centroid=[5.0, 5.0])
    positions = np.zeros((count + 1, 3), np.float32)
    positions[:, 0] = np.arange(count + 1)
    positions[-1, 2] = np.nan
    hinge = {"axis": [0.0, 0.0, 1.0], "point": [0.0, 0.0, 0.0], "position": 0.5, "rate": 2.0}
    return builders.update(
        [7, 7, 1, 1, *[UNDETERMINED] * (count - 4), 9],
        scene="my-lab",
        stamp_ns=stamp_ns,
        sources=[SourceRef(name=name, session=SESSION) for name in "ab"],
        track_source=[0] * count + [1],
        track_confidence=[0.9] * (count + 1),
        track_position=positions,
        hypotheses=[rest, body, image],
        joints=[Joint(parent=1, child=7, space="world", kind="revolute", confidence=0.9, **hinge)],
    )


@pytest.fixture(scope="module")
def read():
    """Messages of one update by topic, decoded."""
    store, decoded = reader(), {}
    for topic, kind, message in Converter("my-lab").convert(update()):
        decoded.setdefault(topic, []).append(store.deserialize_cdr(to_cdr(message, kind), kind))
    return decoded


def numbers(value):
    return [getattr(value, name) for name in "xyzw" if hasattr(value, name)]


@pytest.mark.parametrize("stamp_ns", [2**31 * S, 2**62])
def test_times_that_ros_cannot_say_are_the_nearest_that_it_can(stamp_ns):
    late = replace(update(stamp_ns=stamp_ns), period_ns=2**62)
    store = reader()
    for _, kind, message in Converter("my-lab").convert(late):
        read = store.deserialize_cdr(to_cdr(message, kind), kind)
        if kind == CLOUD:
            assert read.header.stamp.sec == 2**31 - 1


def test_type_hashes_are_the_published_ones():
    store = reader()
    assert set(Converter("my-lab").kinds().values()) == set(PUBLISHED)
    for kind, published in PUBLISHED.items():
        assert type_hash(kind) == store.hash_rihs01(kind) == published


def test_a_frame_moves_with_the_body(read):
    (transforms,) = read["/tf"]
    at = {t.child_frame_id: t for t in transforms.transforms}
    assert set(at) == {"comotion/my-lab/1", "comotion/my-lab/7"}
    frame = at["comotion/my-lab/7"]
    assert (frame.header.frame_id, frame.header.stamp.sec, frame.header.stamp.nanosec) == ("world", 5, 250)
    assert numbers(frame.transform.translation) == [1.5, 2.0, 0.5]
    odometry = next(m for m in read["/comotion/my_lab/odometry"] if m.child_frame_id == "comotion/my-lab/7")
    assert numbers(odometry.pose.pose.position) == [1.5, 2.0, 0.5]
    # v + w x r = (0, 1, 0) + (0, 0, 2) x (0.5, 0, 0) = (0, 2, 0), in axes that are turned by 90 degrees.
    assert numbers(odometry.twist.twist.linear) == pytest.approx([2.0, 0.0, 0.0])
    assert numbers(odometry.twist.twist.angular) == pytest.approx([0.0, 0.0, 2.0])


def test_a_detection_has_the_id_and_the_box(read):
    (array,) = read["/comotion/my_lab/detections"]
    detection = next(d for d in array.detections if d.id == "7")
    assert numbers(detection.bbox.size) == pytest.approx([0.6, 0.4, 0.2])
    turn = Rotation.from_quat(numbers(detection.bbox.center.orientation)).as_rotvec()
    np.testing.assert_allclose(turn, [0, 0, np.pi / 2])
    assert detection.results[0].hypothesis.class_id == "moving"
    assert detection.results[0].hypothesis.score == pytest.approx(0.9)


def test_the_cloud_has_labels_and_only_what_is_in_metres(read):
    (cloud,) = read["/comotion/my_lab/features"]
    fields = {f.name: (f.offset, f.datatype) for f in cloud.fields}
    assert fields["label"] == (12, 6)
    step, data = cloud.point_step, cloud.data.tobytes()
    rows = [data[k : k + step] for k in range(0, cloud.row_step, step)]
    assert [struct.unpack_from("<fff", row)[0] for row in rows] == [0, 1, 2, 3, 4, 5]
    assert [struct.unpack_from("<I", row, 12)[0] for row in rows] == [7, 7, 1, 1, *[UNDETERMINED] * 2]
    shades = [struct.unpack_from("<I", row, fields["rgb"][0])[0] for row in rows]
    assert shades[0] == shades[1] != shades[2]
    # The same colour as its box, and grey where nothing is known.
    (array,) = read["/comotion/my_lab/markers"]
    box = next(m.color for m in array.markers if m.ns == "box")
    assert shades[0].to_bytes(3) == bytes(round(255 * value) for value in (box.r, box.g, box.b))
    assert len(set(shades[-1].to_bytes(3))) == 1


def test_markers_are_boxes_of_bodies_and_ids_that_expire(read):
    (array,) = read["/comotion/my_lab/markers"]
    assert {(m.ns, m.id, m.type) for m in array.markers} == {("box", 7, 1), ("id", 7, 9), ("id", 1, 9)}
    assert all(m.lifetime.nanosec == 300_000_000 for m in array.markers)


def test_joints_are_joint_states(read):
    (joints,) = read["/comotion/my_lab/joints"]
    assert joints.name == ["comotion/my-lab/1-7"]
    assert (joints.position.tolist(), joints.velocity.tolist()) == ([0.5], [2.0])


def test_an_update_that_repeats_its_stamp_is_not_sent_again():
    converter = Converter("my-lab")
    assert list(converter.convert(update()))
    assert list(converter.convert(update())) == []


def test_keys_tokens_and_attachment_follow_rmw_zenoh():
    assert topic_key("/tf", 5, dds_name(TF), "H") == "5/tf/tf2_msgs::msg::dds_::TFMessage_/H"
    node = Node(5, "abc", "comotion_lab")
    assert node.token() == "@ros2_lv/5/abc/0/0/NN/%/%/comotion_lab"
    assert node.publisher_token(2, "/comotion/lab/markers", MARKERS, "H") == (
        "@ros2_lv/5/abc/0/2/MP/%/%/comotion_lab/%comotion%lab%markers/"
        "visualization_msgs::msg::dds_::MarkerArray_/H/::,10:,:,:,,"
    )
    raw = attachment(3, 77, b"g" * 16)
    assert (len(raw), struct.unpack("<qqB", raw[:17])) == (33, (3, 77, 16))
    assert [topic_chunk(name) for name in ("my-lab", "3d")] == ["my_lab", "s3d"]


def test_a_bag_is_read_by_another_reader(tmp_path):
    pytest.importorskip("mcap")
    decoder = pytest.importorskip("mcap_ros2.reader")
    from comotion_clients.ros2.process import Bag

    with Bag(tmp_path / "bodies.mcap") as bag:
        for topic, kind, message in Converter("my-lab").convert(update()):
            bag.write(topic, kind, to_cdr(message, kind), 42)
    with (tmp_path / "bodies.mcap").open("rb") as file:
        topics = {m.channel.topic: m.ros_msg for m in decoder.read_ros2_messages(file)}
    assert {t.child_frame_id for t in topics["/tf"].transforms} == {"comotion/my-lab/1", "comotion/my-lab/7"}
    assert topics["/comotion/my_lab/detections"].detections[1].id == "7"
    assert len(topics) == 6


def test_in_a_frame_that_moves_all_is_in_its_axes():
    """The camera is turned by 90 degrees about z and shifted; the body has not moved in the world."""
    half = float(np.sqrt(0.5))
    frame = Pose(translation=[1.0, 0.0, 0.0], rotation=[0.0, 0.0, half, half])
    still = Pose(translation=[0.0] * 3, rotation=[0.0, 0.0, 0.0, 1.0])
    bodies = [replace(h, pose=still) if h.id == 7 else h for h in update().hypotheses]
    carried = replace(update(), frames={"world": frame}, hypotheses=bodies)
    store = reader()
    raw = next(to_cdr(m, k) for topic, k, m in Converter("my-lab").convert(carried) if topic == "/tf")
    at = {t.child_frame_id: t.transform for t in store.deserialize_cdr(raw, TF).transforms}
    body, world = at["comotion/my-lab/7"], at["comotion/my-lab/world/world"]
    assert numbers(body.translation) == [1.5, 2.0, 0.5]
    for pose in (body, world):
        turn = Rotation.from_quat(numbers(pose.rotation)).as_rotvec()
        np.testing.assert_allclose(turn, [0, 0, -np.pi / 2], atol=1e-12)
    # x(frame) = R^T (x(world) - t): the origin of the world is at (0, 1, 0) in the axes of the camera.
    np.testing.assert_allclose(numbers(world.translation), [0, 1, 0], atol=1e-12)
