"""Poses, labelled clouds and joint states of ROS 2 are read; anything else is refused and counted."""

from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="needs the extra ros")

from comotion_schemas.errors import InputError
from comotion_schemas.ros_types import store, topic_key
from comotion_sources.proprioception.joints import JOINT_STATE, JointSample, read_bag, ros_sample
from comotion_sources.ros2.process import CLOUD, KINDS, NAMED_POSES, TF, Converter, relay
from comotion_sources.runtime import SourcePublisher

from ..ros_messages import encode_sample, header, make, raw

POINT, QUATERNION = (partial(make, f"geometry_msgs/msg/{kind}") for kind in ("Point", "Quaternion"))
FIELD = partial(make, "sensor_msgs/msg/PointField", count=1)


def transform(child, x, frame="world"):
    place = make("geometry_msgs/msg/Vector3", x=x, y=0.0, z=1.0)
    turn = QUATERNION(x=0.0, y=0.0, z=0.0, w=2.0)
    moved = make("geometry_msgs/msg/Transform", translation=place, rotation=turn)
    kind = "geometry_msgs/msg/TransformStamped"
    return make(kind, header=header(frame), child_frame_id=child, transform=moved)


def tf(*transforms):
    return raw(make(TF, transforms=list(transforms)), TF)


def cloud(fields=("x", "y", "z", "id"), count=3):
    kind = np.dtype([(name, "<u4" if name == "id" else "<f4") for name in fields])
    points = np.zeros(count, kind)
    points["x"] = np.arange(count)
    if "id" in fields:
        points["id"] = 10 + np.arange(count)
    message = make(
        CLOUD,
        header=header("map"),
        height=1,
        width=count,
        fields=[FIELD(name=n, offset=kind.fields[n][1], datatype=6 if n == "id" else 7) for n in fields],
        is_bigendian=False,
        point_step=kind.itemsize,
        row_step=kind.itemsize * count,
        data=points.view(np.uint8),
        is_dense=True,
    )
    return raw(message, CLOUD)


def test_frames_of_tf_are_features_that_keep_their_ids():
    converter = Converter("cup*")
    (first,) = converter.convert(TF, tf(transform("cup1", 1.0), transform("robot", 9.0)), 0)
    (second,) = converter.convert(TF, tf(transform("cup2", 2.0), transform("cup1", 1.5)), 0)
    assert (first[0], first[1]["stamp_ns"], first[1]["ids"].tolist()) == ("world", 5_000_000_007, [0])
    assert dict(zip(second[1]["ids"].tolist(), second[1]["positions"][:, 0].tolist(), strict=True)) == {
        1: 2.0,
        0: 1.5,
    }
    assert second[1]["quaternions"].tolist() == [[0, 0, 0, 1]] * 2


def test_bodies_of_motion_capture_have_names():
    place, turn = POINT(x=1.0, y=2.0, z=3.0), QUATERNION(x=0.0, y=0.0, z=0.0, w=1.0)
    pose = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
    sample = make("motion_capture_tracking_interfaces/msg/NamedPose", name="drone", pose=pose)
    message = make(NAMED_POSES, header=header(), poses=[sample])
    (features,) = Converter().convert(NAMED_POSES, raw(message, NAMED_POSES), 0)
    assert features[1]["positions"].tolist() == [[1, 2, 3]]


def test_a_cloud_has_ids_or_is_refused():
    (features,) = Converter().convert(CLOUD, cloud(), 0)
    assert (features[0], features[1]["ids"].tolist()) == ("map", [10, 11, 12])
    assert features[1]["positions"][:, 0].tolist() == [0, 1, 2]
    with pytest.raises(InputError, match="one of id, track_id"):
        Converter().convert(CLOUD, cloud(("x", "y", "z")), 0)


def test_what_does_not_fit_is_counted_and_the_rest_goes_on():
    source = SourcePublisher("ros2", space="world", unit="m", dim=3, drop_invalid=True)
    sent = []
    source.put = sent.append
    key = "0/tf/tf2_msgs::msg::dds_::TFMessage_/H"
    arrivals = [
        (key, tf(transform("a", 1.0)), 0),
        None,
        (key, tf(transform("b", 1.0, frame="odom")), 0),
        (key, b"nonsense", 0),
        ("0/tf/std_msgs::msg::dds_::String_/H", b"", 0),
        (key, tf(transform("a", float("inf")), transform("c", 2.0)), 0),
    ]
    relay(arrivals, source, Converter(), None)
    assert [batch.ids.tolist() for batch in sent] == [[0], [2]]
    assert source.dropped == {"space-mismatch": 1, "malformed": 1, "schema": 1, "non-finite": 1}
    assert source._status().feature_names == {"0": "a", "1": "b", "2": "c"}


def sample(stamp_ns=1_795_227_314_415_000_123, names=("a", "b")):
    return JointSample(stamp_ns, names, np.linspace(-1, 2, len(names)))


def read_joints(payload):
    assert np.isfinite(ros_sample(payload, 0).positions).all()


# A whole message of a kind, and what reads it.
READERS = {kind: (cloud(), partial(Converter().convert, kind, received_ns=0)) for kind in KINDS}
READERS["joints"] = encode_sample(sample()), read_joints


@pytest.mark.parametrize(("whole", "read"), READERS.values(), ids=READERS)
@given(content=st.binary(max_size=300))
@settings(max_examples=100)
def test_any_bytes_are_refused_or_read_whole(whole, read, content):
    for payload in (content, whole[: len(content)], b"\0\1\0\0" + content):
        with suppress(InputError):
            read(payload)


def write_bag(path, topics, kind):
    from rosbags.rosbag2 import StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, samples in topics.items():
            connection = writer.add_connection(topic, JOINT_STATE, typestore=store())
            for sample in samples:
                writer.write(connection, sample.stamp_ns + 5, encode_sample(sample))
    return path


@pytest.mark.parametrize("kind", ["mcap", "sqlite"])
@pytest.mark.parametrize("folder", [True, False])
def test_bags_are_read_in_order(tmp_path, kind, folder):
    samples = [sample(10**18 + k * 10**7) for k in range(5)]
    path = write_bag(tmp_path / "bag", {"/joint_states": samples}, kind)
    if not folder:
        path = next(p for p in path.iterdir() if p.suffix in {".mcap", ".db3"})
    read = list(read_bag(path))
    assert [s.stamp_ns for s in read] == [s.stamp_ns for s in samples]
    assert read[3].positions.tolist() == samples[3].positions.tolist()


def test_a_bag_with_two_robots_wants_a_topic(tmp_path):
    path = write_bag(tmp_path / "bag", {"/left": [sample()], "/right": [sample(names=("c",))]}, "mcap")
    with pytest.raises(InputError, match="several: /left, /right; name one"):
        list(read_bag(path))
    assert list(next(read_bag(path, "/right")).names) == ["c"]
    with pytest.raises(InputError, match="named /up: none"):
        list(read_bag(path, "/up"))


def test_what_is_no_bag_is_one_clear_line(tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(40))
    for path in (tmp_path / "none.mcap", tmp_path, broken):
        with pytest.raises(InputError) as error:
            list(read_bag(path))
        assert "\n" not in str(error.value)


def test_the_key_is_that_of_rmw_zenoh():
    kind = "sensor_msgs::msg::dds_::JointState_"
    assert topic_key("/joint_states", kind=kind) == f"0/joint_states/{kind}/*"
    assert topic_key("ur5/joint_states/", 7) == "7/ur5/joint_states/*/*"
    for topic in ("", "/", "a//b", "a/**", "a b", "7up", "a/$*", "é"):
        with pytest.raises(InputError, match="is not a ROS topic"):
            topic_key(topic)
