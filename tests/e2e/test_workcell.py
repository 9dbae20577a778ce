"""The workcell as a user runs it: real processes, every input of proprioception, what goes wrong."""

import signal

import numpy as np
import pytest

from comotion_schemas import JointStates, Keys, encode
from comotion_schemas.transport import declare_publisher

pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.proprioception.joints import JointSample
from comotion_sources.proprioception.kinematics import Kinematics
from comotion_sources.workcell import Scene

from .waiting import until_heard

KEYS = Keys()
ARM = Scene("arm")
STAMP_NS = 5_000_000_000


def configuration(stamp_ns):
    return ARM.configuration(stamp_ns % round(ARM.period * 1e9) * 1e-9)


def links(stamp_ns):
    """Positions of the robot's links at a stamp."""
    sample = JointSample(stamp_ns, ARM.joints, configuration(stamp_ns))
    return pytest.approx(Kinematics(ARM.model, ARM.robot).poses(sample).positions, abs=1e-5)


def test_robot_and_camera_see_one_workcell_also_after_its_restart(start, endpoint, session, listen):
    """Three processes that share nothing but the wire agree on where the hand is."""
    robot = listen(session, KEYS.stream("obs", "robot"), "obs")
    camera = listen(session, KEYS.stream("obs", "klt-a"), "obs")
    truths = listen(session, KEYS.streams("truth"), "truth")
    at = ("--connect", endpoint)
    klt = start("source", "klt", "workcell:arm/a?size=320x240&rate=5", "--name", "klt-a", *at)
    klt.wait_line(lambda line: "waiting for joint states 'workcell'" in line)
    workcell = start("source", "workcell", "arm", *at)
    start("source", "proprioception", "workcell:arm", "--name", "robot", *at)
    batch = robot.until(lambda b: len(b.ids) >= 12)
    assert len(np.unique(batch.stamps_ns)) >= 3, "several instants in one batch"
    for stamp in np.unique(batch.stamps_ns).tolist():
        assert batch.positions[batch.stamps_ns == stamp] == links(stamp)
    seen = camera.until(lambda b: len(b.ids) > 50)
    assert (seen.space, seen.unit, seen.dim) == ("world", "m", 3)
    truth = truths.until(lambda t: t.source == "klt-a")
    assert truth.names["0"] == "background"
    # Features on what cannot move are at table height or above it, and within the room.
    still = np.isin(seen.ids, truth.ids[truth.objects == 0])
    assert still.sum() > 20
    assert (seen.positions[still, 2] > -0.9).all()
    assert (np.abs(seen.positions[still]) < 1.9).all()
    workcell.kill()
    start("source", "workcell", "arm", *at)
    assert robot.until(lambda b: b.stamp_ns > batch.stamp_ns + 10**9)
    assert camera.until(lambda b: b.stamp_ns > seen.stamp_ns + 10**9 and len(b.ids) > 50)
    klt.signal(signal.SIGINT)
    assert klt.wait() == 0


def joint_states(seq, names=ARM.joints, source="ur"):
    positions = [*configuration(STAMP_NS), 0.0][: len(names)]
    fields = {"session": "0" * 16, "seq": seq, "stamp_ns": STAMP_NS, "names": list(names)}
    return encode(JointStates(source=source, positions=positions, **fields))


def over_zenoh(session):
    """Joint states of which one is right, and what is refused."""
    publisher = until_heard(declare_publisher(session, KEYS.stream("joints", "ur"), "joints"))
    wrong = (joint_states(0, source="other"), joint_states(1, ARM.joints[:3]), b"\xc1 no msgpack")
    for payload in (*wrong, joint_states(2, [*ARM.joints, "unknown"]), joint_states(3)):
        publisher.put(payload)
    return {"malformed": 1, "source-mismatch": 1, "schema": 1}


def over_rmw_zenoh(session):
    pytest.importorskip("rosbags", reason="needs the extra ros (rosbags)")
    from ..ros_messages import encode_sample

    key = "3/ur/joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_a13e"
    publisher = until_heard(session.declare_publisher(key))
    publisher.put(b"\x00\x01\x00\x00broken")
    publisher.put(encode_sample(JointSample(STAMP_NS, ARM.joints, configuration(STAMP_NS))))
    return {"malformed": 1}


INPUTS = {over_zenoh: ("--joints", "ur"), over_rmw_zenoh: ("--ros", "/ur/joint_states", "--ros-domain", "3")}


@pytest.mark.parametrize(("send", "words"), INPUTS.items(), ids=lambda value: getattr(value, "__name__", ""))
def test_joint_states_become_poses_and_malformed_ones_are_counted(
    send, words, start, endpoint, session, listen
):
    poses = listen(session, KEYS.stream("obs", "robot"), "obs")
    statuses = listen(session, KEYS.stream("status", "robot"), "status")
    robot = ("source", "proprioception", "workcell:arm", "--name", "robot", "--batch", "0")
    start(*robot, *words, "--connect", endpoint)
    rejected = send(session)
    assert poses.until(lambda b: len(b.ids)).positions == links(STAMP_NS)
    status = statuses.until(lambda s: s.rejected == rejected)
    # The same stamp once more is late.
    assert status.counters.get("late", 0) == (send is over_zenoh)
