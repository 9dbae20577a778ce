"""What clients make of joints: URDF, lines, rows."""

import numpy as np
import pytest
from rich.console import Console

from comotion_clients.scene_model import SceneModel
from comotion_clients.urdf import to_urdf
from comotion_clients.viewing.hypotheses import draw_joints
from comotion_clients.watch_view import render
from comotion_schemas import Box, Joint, Pose
from comotion_schemas.colours import Palette
from comotion_schemas.naming import joint_words, read_names

from .. import builders

IDENTITY = [0.0, 0.0, 0.0, 1.0]


def body(one, centre, state="moving"):
    pose = Pose(translation=[0.0, 0.0, 0.0], rotation=IDENTITY)
    box = Box(center=centre, half=[0.2, 0.01, 0.3], rotation=IDENTITY)
    return builders.hypothesis(one, size=5, state=state, centroid=centre, pose=pose, box=box)


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
DRAWER = Joint(
    parent=2,
    child=3,
    space="world",
    kind="prismatic",
    confidence=0.98,
    axis=[0.0, 1.0, 0.0],
    point=[1.2, 0.5, 0.3],
    position=0.1,
    rate=0.0,
    lower=0.0,
    upper=0.3,
)
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
    shown = update([DOOR, DRAWER, FREE])
    names = {2: "door"}
    shape, words = draw_joints("space", shown.hypotheses, shown.joints, 0.1, Palette(), names)
    assert words.labels == ("door turns on 1, 0 to 69°", "3 slides on door, 0.00 to 0.30 m")
    assert shape.path == "space/joints"
    assert len(shape.ends) == len(shape.colours)
    assert draw_joints("space", shown.hypotheses, [FREE], 0.1, Palette()) == []


def test_watch_shows_joints_in_degrees_and_metres():
    model = SceneModel("default", {2: "door"})
    model.on_update(update([DOOR, DRAWER, FREE]), arrived=0.0)
    console = Console(width=140)
    with console.capture() as captured:
        console.print(render(model.snapshot(0.0), 140, 30, "size"))
    assert "door turns on 1, 0 to 69°, at 28.6°" in captured.get()
    assert "3 slides on door, 0.00 to 0.30 m, at 0.100 m" in captured.get()


def test_joints_are_words_with_the_names_that_people_give():
    names = read_names(["1=shelf", "2=door"])
    assert joint_words(DOOR, names) == "door turns on shelf, 0 to 69°"
    assert joint_words(FREE) == "4 moves freely against 1"
    for wrong in ("truck", "2=", "=truck", "two=truck", "2=\x1b[31m", "2=" + 41 * "x"):
        with pytest.raises(ValueError, match="like 2=truck"):
            read_names([wrong])
