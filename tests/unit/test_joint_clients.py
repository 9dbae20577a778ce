"""What clients make of a scene with joints: URDF, words, names, paths, colours, and live Foxglove."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from comotion_clients.bodies import HypothesisNames
from comotion_clients.formats import save_paths, to_urdf
from comotion_schemas import Box, Joint, Pose
from comotion_schemas.colours import BACKGROUND, COLOURS, Palette, colour
from comotion_schemas.hypotheses import SourceRef
from comotion_schemas.naming import joint_words, read_names

from .. import builders
from ..builders import SESSION, hypothesis

IDENTITY = [0.0, 0.0, 0.0, 1.0]


def body(number, centre, state="moving"):
    pose = Pose(translation=[0.0, 0.0, 0.0], rotation=IDENTITY)
    box = Box(center=centre, half=[0.2, 0.01, 0.3], rotation=IDENTITY)
    return builders.hypothesis(number, size=5, state=state, centroid=centre, pose=pose, box=box)


DOOR = Joint(
    parent=1,
    child=2,
    space="world",
    kind="revolute",
    confidence=0.99,
    axis=[0.0, 0.0, 1.0],
    point=[1.0, 0.5, 0.3],
    position=0.5,
    rate=0.1,
    lower=0.0,
    upper=1.2,
    sigma_position=0.01,
)
# A drawer in the door: its chain is longer.
SLIDE = {"kind": "prismatic", "axis": [0.0, 1.0, 0.0], "point": [1.2, 0.5, 0.3]}
DRAWER = replace(DOOR, parent=2, child=3, position=0.1, rate=0.0, upper=0.3, sigma_position=None, **SLIDE)
FREE = Joint(parent=1, child=4, space="world", kind="free", confidence=1.0)


def update(joints):
    bodies = [
        body(1, [0.5, 0.0, 0.0], "static"),
        body(2, [1.2, 0.5, 0.3]),
        body(3, [1.3, 0.6, 0.3]),
        body(4, [0.0, 2.0, 0.0]),
    ]
    return builders.update(hypotheses=bodies, joints=joints)


def test_mujoco_reads_the_urdf_and_moves_the_joints():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(to_urdf(update([DOOR, DRAWER, FREE])))
    data = mujoco.MjData(model)
    assert model.joint("joint-2").type == mujoco.mjtJoint.mjJNT_HINGE
    assert model.joint("joint-3").type == mujoco.mjtJoint.mjJNT_SLIDE
    assert model.joint("joint-4").type == mujoco.mjtJoint.mjJNT_FREE
    assert model.joint("joint-2").range == pytest.approx([-0.5, 0.7])
    data.qpos[model.joint("joint-2").qposadr] = np.pi / 2
    data.qpos[model.joint("joint-3").qposadr] = 0.1
    mujoco.mj_kinematics(model, data)
    # The drawer was 0.2 m beside the hinge along x, and moves along its own y, now -x.
    assert data.body("hypothesis-3").xpos == pytest.approx([0.9, 0.7, 0.3])


def test_viewers_draw_joints():
    pytest.importorskip("rerun", reason="needs the extra view")
    from comotion_clients.viewing.hypotheses import BodyDrawing

    shown = update([DOOR, DRAWER, FREE])
    drawing = BodyDrawing("space", (0.0, 0.0, 1.0), 0.1, Palette(), {2: "door"})
    shape, words = drawing.joints(shown.hypotheses, shown.joints)
    texts = words.drawn[0].labels.as_arrow_array().to_pylist()
    assert texts == ["door turns on 1, 0 to 69°", "3 slides on door, 0.00 to 0.30 m"]
    assert shape.path == "space/joints"
    (lines,) = shape.drawn
    assert len(lines.strips.as_arrow_array()) == len(lines.colors.as_arrow_array())
    assert drawing.joints(shown.hypotheses, [FREE]) == []


def test_joints_are_words_with_the_names_that_people_give():
    names = read_names(["1=shelf", "2=door"])
    assert joint_words(DOOR, names) == "door turns on shelf, 0 to 69°"
    assert joint_words(FREE) == "4 moves freely against 1"
    for wrong in ("truck", "2=", "=truck", "two=truck", "2=\x1b[31m", "2=" + 41 * "x"):
        with pytest.raises(ValueError, match="like 2=truck"):
            read_names([wrong])


STATUS = builders.status("arm", "source", feature_names={"0": "elbow", "1": "tool"})


def held(*hypotheses, session=SESSION):
    """An update whose features 0, 1, ... of the arm are in these hypotheses."""
    arm = [SourceRef(name="arm", session=session)]
    return replace(builders.update(hypotheses), sources=arm, hypotheses=update([]).hypotheses)


def names_after(*updates, given=None):
    names = HypothesisNames(given)
    names.on_status(STATUS)
    for update in updates:
        names.on_update(update)
    return dict(names)


# The robot is late: no feature of it is in this update.
LATE = replace(held(), hypotheses=held(3, 2).hypotheses)
# What holds the features elbow and tool in each update, and the names then.
NAMED = {
    "by the link that moves with it": ([held(3, 2)], {3: "elbow", 2: "tool"}),
    "one that holds both has the name of the last": ([held(2, 2)], {2: "tool"}),
    "not what rests with the background": ([held(1, 2)], {2: "tool"}),
    "not by ids of another session": ([held(1, 2, session="1" * 16)], {}),
    "while nobody holds the feature": ([held(3, 2), LATE], {3: "elbow", 2: "tool"}),
    "until another body holds it": ([held(3, 2), held(2, 2)], {2: "tool"}),
    "both part": ([held(2, 2), held(2, 3)], {2: "elbow", 3: "tool"}),
    "the one that keeps a link keeps its name": ([held(3, 2), held(3, 3)], {3: "elbow"}),
}


@pytest.mark.parametrize(("updates", "expected"), NAMED.values(), ids=NAMED)
def test_a_body_is_called(updates, expected):
    assert names_after(*updates) == expected
    # What a person gives comes first.
    assert names_after(*updates, given={2: "gripper"})[2] == "gripper"


def test_a_body_that_is_linked_to_one_with_a_name_has_it_too():
    update = held(3, 2)
    image = replace(update.hypotheses[3], space="door/pixels", linked=[2])
    update = replace(update, hypotheses=[*update.hypotheses[:3], image])
    assert names_after(update) == {3: "elbow", 2: "tool", image.id: "tool"}
    assert names_after(update, given={2: "door"})[image.id] == "door"


def moved(number):
    # The camera goes along x, and turns a quarter about z.
    half = np.pi / 4
    pose = Pose(translation=[0.5 * number, 0.0, 1.0], rotation=[0.0, 0.0, np.sin(half), np.cos(half)])
    return replace(update([]), stamp_ns=1_000_000_000 + number * 100_000_000, frames={"cam": pose})


def test_each_instant_of_a_moving_camera_is_one_line(tmp_path):
    files = save_paths(tmp_path / "out", [moved(0), moved(0), moved(1)])
    camera = tmp_path / "out" / "camera-cam.tum"
    assert camera in files
    assert np.loadtxt(camera) == pytest.approx(
        np.array([[1.0, 0, 0, 1, 0, 0, 0.5**0.5, 0.5**0.5], [1.1, 0.5, 0, 1, 0, 0, 0.5**0.5, 0.5**0.5]])
    )


def test_a_client_of_foxglove_reads_the_numbers_of_an_update():
    pytest.importorskip("foxglove")
    websockets = pytest.importorskip("websockets.sync.client")
    from comotion_clients.foxglove.scene import FoxgloveDisplay

    with FoxgloveDisplay(0) as display:
        # A first message makes the channels known.
        display.on_message(update([DOOR, DRAWER]), 0.0, 1)
        with websockets.connect(display.url, subprotocols=["foxglove.sdk.v1"]) as client:
            channels = {}
            while "/numbers" not in channels:
                message = json.loads(client.recv(timeout=30))
                channels |= {c["topic"]: c for c in message.get("channels", [])}
            assert channels["/joints/world"]["schemaName"] == "foxglove.SceneUpdate"
            wanted = {"id": 7, "channelId": channels["/numbers"]["id"]}
            client.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
            message = b""
            while not isinstance(message, bytes) or not message.startswith(b"\x01"):
                # The subscription is at work some time after it was sent.
                display.on_message(update([DOOR, DRAWER]), 0.0, 2)
                try:
                    message = client.recv(timeout=0.2)
                except TimeoutError:
                    continue
    _, subscription, log_ns = struct.unpack_from("<BIQ", message)
    assert (subscription, log_ns) == (7, 2)
    assert json.loads(message[13:])["hypotheses"] == len(update([]).hypotheses)


def test_a_colour_stays_while_its_hypothesis_is_listed_and_no_two_share_one():
    palette, rng = Palette(), np.random.default_rng(0)
    listed, colours = set(), {}
    for step in range(200):
        listed = {i for i in listed if rng.random() > 0.1} | {step * 7 % 50}
        palette.see([hypothesis(i) for i in listed])
        now = {i: palette.colour(i) for i in listed}
        assert len(set(now.values())) == len(listed)
        assert all(now[i] == colours[i] for i in listed & colours.keys())
        colours = now
    many = list(range(100, 100 + len(COLOURS)))
    palette.see([hypothesis(i) for i in many])
    assert len({palette.colour(i) for i in many}) == len(COLOURS)
    alone = Palette()
    alone.see([hypothesis(1), hypothesis(1 + len(COLOURS))])
    assert alone.colour(1) == colour(1)


def test_the_largest_at_rest_is_the_background_of_its_space():
    palette = Palette()
    elsewhere = hypothesis(3, state="static", space="b")
    small = hypothesis(2, state="undetermined", size=4)
    palette.see([hypothesis(1, state="undetermined", size=30), small, elsewhere])
    assert palette.colour(1) == palette.colour(3) == BACKGROUND
    assert palette.colour(2) == colour(2)
    first, larger = (hypothesis(number, state="static", size=size) for number, size in ((1, 20), (4, 40)))
    palette.see([first, larger, elsewhere])
    assert palette.colour(4) == colour(4)
    palette.see([hypothesis(1, state="moving", size=20)])
    assert palette.colour(1) == colour(1)
