"""Poses and labelled clouds of ROS 2 become observations; anything else is refused and counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="needs the extra ros")

from comotion_schemas import decode
from comotion_schemas.errors import InputError
from comotion_schemas.ros_types import store
from comotion_sources.ros2.convert import (
    CLOUD,
    KINDS,
    NAMED_POSES,
    TF,
    Converter,
    _ids,
    kind_of,
)
from comotion_sources.ros2.process import Ros2Source, _Relay
from comotion_sources.runtime import SourcePublisher

S = 10**9


def make(kind, /, **fields):
    return store().types[kind](**fields)


def header(frame="world", seconds=5):
    stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=7)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def raw(message, kind):
    return bytes(store().serialize_cdr(message, kind))


def transform(child, x, frame="world", seconds=5):
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(frame, seconds),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", x=x, y=0.0, z=1.0),
            rotation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=2.0),
        ),
    )


def tf(*transforms):
    return raw(make(TF, transforms=list(transforms)), TF)


def cloud(fields=("x", "y", "z", "id"), count=3):
    kind = np.dtype([(name, "<u4" if name == "id" else "<f4") for name in fields])
    points = np.zeros(count, kind)
    points["x"] = np.arange(count)
    if "id" in fields:
        points["id"] = 10 + np.arange(count)
    described = [
        make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=kind.fields[name][1],
            datatype=6 if name == "id" else 7,
            count=1,
        )
        for name in fields
    ]
    message = make(
        CLOUD,
        header=header("map"),
        height=1,
        width=count,
        fields=described,
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
    assert (first.frame, first.stamp_ns, first.ids.tolist()) == ("world", 5 * S + 7, [0])
    assert dict(zip(second.ids.tolist(), second.positions[:, 0].tolist(), strict=True)) == {1: 2.0, 0: 1.5}
    assert second.quaternions.tolist() == [[0, 0, 0, 1]] * 2


def test_bodies_of_motion_capture_have_names():
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    one = make("motion_capture_tracking_interfaces/msg/NamedPose", name="drone", pose=pose)
    message = make(NAMED_POSES, header=header(), poses=[one])
    (found,) = Converter().convert(NAMED_POSES, raw(message, NAMED_POSES), 0)
    assert found.positions.tolist() == [[1, 2, 3]]


def test_a_cloud_has_ids_or_is_refused():
    (found,) = Converter().convert(CLOUD, cloud(), 0)
    assert (found.frame, found.ids.tolist()) == ("map", [10, 11, 12])
    assert found.positions[:, 0].tolist() == [0, 1, 2]
    with pytest.raises(InputError, match="one of id, track_id"):
        Converter().convert(CLOUD, cloud(("x", "y", "z")), 0)


def test_numbers_that_are_no_id_are_left_out_later():
    assert _ids(np.array([np.nan, 3, 2.5, 1e30, -np.inf], np.float32)).tolist() == [-1, 3, -1, -1, -1]


def test_the_type_is_in_the_key():
    assert kind_of("0/tf/tf2_msgs::msg::dds_::TFMessage_/RIHS01_x") == TF
    assert kind_of("0/chatter/std_msgs::msg::dds_::String_/RIHS01_x") is None


@given(st.sampled_from(KINDS), st.binary(max_size=300))
@settings(max_examples=100)
def test_any_bytes_are_refused_or_read(kind, rest):
    for payload in (rest, b"\0\1\0\0" + rest, cloud()[: len(rest)]):
        try:
            Converter().convert(kind, payload, 0)
        except InputError:
            continue


class Sent(list):
    put = list.append


def test_what_does_not_fit_is_counted_and_the_rest_goes_on():
    source = SourcePublisher("ros2", space="world", unit="m", dim=3, drop_invalid=True)
    source._publishers["obs"] = Sent()
    relay, key = _Relay(source, Ros2Source(topic="/tf")), "0/tf/tf2_msgs::msg::dds_::TFMessage_/H"
    relay.take(key, tf(transform("a", 1.0)), 0)
    relay.take(key, tf(transform("b", 1.0, frame="odom")), 0)
    relay.take(key, b"nonsense", 0)
    relay.take("0/tf/std_msgs::msg::dds_::String_/H", b"", 0)
    relay.take(key, tf(transform("a", float("inf")), transform("c", 2.0, seconds=5)), 0)
    batches = [decode(one) for one in source._publishers["obs"]]
    assert [b.ids.tolist() for b in batches] == [[0], [2]]
    assert source.dropped == {"space-mismatch": 1, "malformed": 1, "schema": 1, "non-finite": 1}
    assert source._status().feature_names == {"0": "a", "1": "b", "2": "c"}
