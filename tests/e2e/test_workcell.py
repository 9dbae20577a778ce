"""The workcell as a user runs it: real processes, every input of proprioception, what goes wrong."""

import signal

import numpy as np
import pytest

from comotion_schemas import JointStates, Keys, ObservationBatch, TruthBatch, encode
from comotion_schemas.transport import declare_publisher

pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.proprioception.joints import JointSample
from comotion_sources.proprioception.kinematics import Kinematics
from comotion_sources.workcell import Scene

from .tracker import until_heard

KEYS = Keys()


def expected(scene, stamp_ns):
    """Positions of the robot's links at a stamp."""
    kinematics = Kinematics(scene.model, scene.robot)
    q = scene.configuration(stamp_ns % round(scene.period * 1e9) * 1e-9)
    return kinematics.poses(JointSample(stamp_ns, scene.joints, q)).positions


def test_robot_and_camera_see_one_workcell(start, endpoint, session, listen):
    """Three processes that share nothing but the wire agree on where the hand is."""
    scene = Scene("arm")
    robot = listen(session, KEYS.stream("obs", "robot"), "obs")
    camera = listen(session, KEYS.stream("obs", "klt-a"), "obs")
    truths = listen(session, KEYS.streams("truth"), "truth")
    start("source", "workcell", "arm", "--connect", endpoint)
    start("source", "proprioception", "workcell:arm", "--name", "robot", "--connect", endpoint)
    batch: ObservationBatch = robot.until(lambda b: len(b.ids) >= 12)
    assert batch.stamps_ns is not None
    assert len(np.unique(batch.stamps_ns)) >= 3, "several instants in one batch"
    for stamp in np.unique(batch.stamps_ns).tolist():
        rows = batch.stamps_ns == stamp
        assert batch.positions[rows] == pytest.approx(expected(scene, stamp), abs=1e-5)
    what = "workcell:arm/a?size=320x240&rate=5"
    klt = start("source", "klt", what, "--name", "klt-a", "--connect", endpoint)
    seen: ObservationBatch = camera.until(lambda b: len(b.ids) > 50)
    assert (seen.space, seen.unit, seen.dim) == ("world", "m", 3)
    told: TruthBatch = truths.until(lambda t: t.source == "klt-a")
    assert told.names["0"] == "background"
    # Features on what cannot move are at table height or above it, and within the room.
    still = np.isin(seen.ids, told.ids[told.objects == 0])
    assert still.sum() > 20
    assert (seen.positions[still, 2] > -0.9).all()
    assert (np.abs(seen.positions[still]) < 1.9).all()
    klt.signal(signal.SIGINT)
    assert klt.wait() == 0


def test_the_camera_waits_for_the_workcell_and_survives_its_restart(start, endpoint, session, listen):
    camera = listen(session, KEYS.stream("obs", "klt"), "obs")
    klt = start("source", "klt", "workcell:truck/a?size=160x120&rate=5", "--connect", endpoint)
    klt.wait_line(lambda line: "waiting for joint states 'workcell'" in line)
    first = start("source", "workcell", "truck", "--connect", endpoint)
    before = camera.until(lambda b: len(b.ids) > 5)
    first.kill()
    start("source", "workcell", "truck", "--connect", endpoint)
    camera.drain()
    after = camera.until(lambda b: len(b.ids) > 5)
    assert after.stamp_ns > before.stamp_ns


def joints(seq, stamp_ns, names, source="ur"):
    positions = np.linspace(0.1, 0.3, len(names))
    fields = {"session": "0" * 16, "seq": seq, "stamp_ns": stamp_ns, "names": names, "positions": positions}
    return encode(JointStates(source=source, **fields))


def test_malformed_joint_states_are_counted_and_the_process_goes_on(start, endpoint, session, listen):
    names = [f"arm_{name}" for name in ("yaw", "shoulder", "elbow", "wrist", "roll")]
    poses = listen(session, KEYS.stream("obs", "robot"), "obs")
    statuses = listen(session, KEYS.stream("status", "robot"), "status")
    options = ("--joints", "ur", "--name", "robot", "--batch", "0")
    process = start("source", "proprioception", "workcell:arm", *options, "--connect", endpoint)
    publisher = until_heard(declare_publisher(session, KEYS.stream("joints", "ur"), "joints"))
    publisher.put(b"\xc1 no msgpack")
    publisher.put(joints(0, 1_000_000_000, names, source="other"))
    publisher.put(joints(1, 1_000_000_000, names[:3]))
    publisher.put(joints(2, 1_000_000_000, [*names, "unknown"]))
    batch = poses.until(lambda b: b.stamp_ns == 1_000_000_000)
    assert len(batch.ids) == 4
    publisher.put(joints(3, 1_000_000_000, names))
    status = statuses.until(lambda s: s.counters.get("late") == 1)
    assert status.rejected == {"malformed": 1, "source-mismatch": 1, "schema": 1}
    assert "no position of joint 'arm_wrist'" in process.output
    publisher.undeclare()


def test_joint_states_live_from_rmw_zenoh(start, endpoint, session, listen):
    pytest.importorskip("rosbags", reason="needs the extra ros (rosbags)")
    from ..ros_messages import encode_sample

    scene = Scene("arm")
    poses = listen(session, KEYS.stream("obs", "robot"), "obs")
    statuses = listen(session, KEYS.stream("status", "robot"), "status")
    options = ("--ros", "/ur/joint_states", "--ros-domain", "3", "--name", "robot", "--batch", "0")
    start("source", "proprioception", "workcell:arm", *options, "--connect", endpoint)
    key = "3/ur/joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_a13e"
    publisher = until_heard(session.declare_publisher(key))
    publisher.put(b"\x00\x01\x00\x00broken")
    q = scene.configuration(5.0)
    publisher.put(encode_sample(JointSample(5_000_000_000, scene.joints, q)))
    batch = poses.until(lambda b: len(b.ids))
    assert batch.stamp_ns == 5_000_000_000
    assert batch.positions == pytest.approx(expected(scene, 5_000_000_000), abs=1e-5)
    statuses.until(lambda s: s.rejected == {"malformed": 1})
    publisher.undeclare()


def test_a_csv_log_is_played_and_ends(start, endpoint, session, listen, tmp_path):
    scene = Scene("arm")
    lines = [",".join(("time", *scene.joints))]
    lines += [",".join(map(repr, (k / 100, *scene.configuration(k / 100).tolist()))) for k in range(20)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    poses = listen(session, KEYS.stream("obs", "robot"), "obs")
    options = ("--csv", path, "--original-stamps", "--name", "robot", "--link", "hand")
    process = start("source", "proprioception", "workcell:arm", *options, "--connect", endpoint)
    last = poses.until(lambda b: b.stamp_ns == 190_000_000)
    assert last.positions[-1] == pytest.approx(expected(scene, 190_000_000)[-1], abs=1e-5)
    assert process.wait() == 0
