"""ROS 2 joint states: CDR both ways through rosbags, bags, and the keys of rmw_zenoh."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

rosbags = pytest.importorskip("rosbags", reason="needs the extra ros (rosbags)")

from comotion_schemas.ros_types import store  # noqa: E402
from comotion_sources.errors import InputError  # noqa: E402
from comotion_sources.proprioception.cdr import (  # noqa: E402
    JOINT_STATE,
    decode_message,
    from_message,
    ros_key,
)
from comotion_sources.proprioception.joint_logs import read_bag  # noqa: E402
from comotion_sources.proprioception.samples import JointSample  # noqa: E402

from ..reference.joint_states import encode_sample  # noqa: E402

NAMES = st.lists(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12), max_size=8, unique=True
)


def sample(stamp_ns: int = 1_795_227_314_415_000_123, names: tuple[str, ...] = ("a", "b")) -> JointSample:
    return JointSample(stamp_ns, names, np.linspace(-1, 2, len(names)))


@given(NAMES, st.integers(1, 2**31 * 10**9 - 1), st.data())
@settings(max_examples=60)
def test_joint_states_round_trip_through_cdr(names: list[str], stamp_ns: int, data: st.DataObject) -> None:
    numbers = st.floats(allow_nan=False, allow_infinity=False)
    positions = np.array(data.draw(st.lists(numbers, min_size=len(names), max_size=len(names))), np.float64)
    raw = encode_sample(JointSample(stamp_ns, names, positions), velocities=positions)
    back = from_message(decode_message(raw), received_ns=5)
    assert back.stamp_ns == stamp_ns
    assert list(back.names) == names
    assert np.array_equal(back.positions, positions)


def test_what_rosbags_itself_serialises_big_endian_too_is_read() -> None:
    message = decode_message(encode_sample(sample()))
    for little in (True, False):
        raw = store().serialize_cdr(message, JOINT_STATE, little_endian=little)
        assert from_message(decode_message(bytes(raw)), 0).positions.tolist() == sample().positions.tolist()


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_any_other_bytes_are_refused_or_read_whole(raw: bytes) -> None:
    for payload in (raw, encode_sample(sample())[: len(raw)], b"\0\1\0\0" + raw):
        try:
            read = from_message(decode_message(payload), 0)
        except InputError:
            continue
        else:
            assert np.isfinite(read.positions).all()


def write_bag(path: Path, topics: dict[str, list[JointSample]], kind: str) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, samples in topics.items():
            connection = writer.add_connection(topic, JOINT_STATE, typestore=store())
            for one in samples:
                writer.write(connection, one.stamp_ns, encode_sample(one))
    return path


@pytest.mark.parametrize("kind", ["mcap", "sqlite"])
@pytest.mark.parametrize("folder", [True, False])
def test_bags_are_read_in_order(tmp_path: Path, kind: str, folder: bool) -> None:
    samples = [sample(10**18 + k * 10**7) for k in range(5)]
    path = write_bag(tmp_path / "bag", {"/joint_states": samples}, kind)
    if not folder:
        path = next(p for p in path.iterdir() if p.suffix in {".mcap", ".db3"})
    read = list(read_bag(path))
    assert [s.stamp_ns for s in read] == [s.stamp_ns for s in samples]
    assert read[3].positions.tolist() == samples[3].positions.tolist()


def test_a_bag_with_two_robots_wants_a_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {"/left": [sample()], "/right": [sample(names=("c",))]}, "mcap")
    with pytest.raises(InputError, match="several: /left, /right; name one"):
        list(read_bag(path))
    assert list(next(read_bag(path, "/right")).names) == ["c"]
    with pytest.raises(InputError, match="named /up: none"):
        list(read_bag(path, "/up"))


def test_what_is_no_bag_is_one_clear_line(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(40))
    for path in (tmp_path / "none.mcap", tmp_path, broken):
        with pytest.raises(InputError) as error:
            list(read_bag(path))
        assert "\n" not in str(error.value)


def test_the_key_is_that_of_rmw_zenoh() -> None:
    assert ros_key("/joint_states") == "0/joint_states/sensor_msgs::msg::dds_::JointState_/*"
    assert ros_key("ur5/joint_states/", 7) == "7/ur5/joint_states/sensor_msgs::msg::dds_::JointState_/*"
    for topic in ("", "/", "a//b", "a/**", "a b", "7up", "a/$*", "é"):
        with pytest.raises(InputError, match="is not a ROS topic"):
            ros_key(topic)
