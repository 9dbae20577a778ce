"""``comotion source proprioception``: the poses of a robot's links."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import UserError
from . import source_options

if TYPE_CHECKING:
    from comotion_sources.calibration.model import Extrinsics
    from comotion_sources.proprioception.joint_readers import JointReader

EPILOG = """
Examples:

  comotion source proprioception workcell:arm --name arm

  comotion source proprioception ur5.urdf --joints ur5 --link tool0 --base 0.4,0,0.8

  comotion source proprioception ur5.urdf --csv joints.csv --link tool0

  comotion source proprioception ur5.urdf --bag run1.mcap --topic /joint_states --link tool0

  comotion source proprioception ur5.urdf --ros /joint_states --ros-connect tcp/192.168.1.20:7447
"""
_WORKCELL = "workcell:"


def proprioception(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="URDF or MJCF file of the robot, or workcell:SCENE.")
    ],
    joints: Annotated[
        str | None,
        typer.Option("--joints", metavar="NAME", help="Follow the joint states NAME of the scene."),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv", metavar="FILE", help="Play a log: stamp_ns or time, then one column per joint."
        ),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option(
            "--bag", metavar="FILE", help="Play sensor_msgs/JointState of a ROS 2 bag (MCAP or SQLite)."
        ),
    ] = None,
    ros: Annotated[
        str | None,
        typer.Option(
            "--ros", metavar="TOPIC", help="Follow a topic of sensor_msgs/JointState over rmw_zenoh."
        ),
    ] = None,
    topic: Annotated[
        str | None, typer.Option("--topic", help="Topic in the bag; needed if it has several.")
    ] = None,
    domain: Annotated[
        int, typer.Option("--ros-domain", envvar="ROS_DOMAIN_ID", min=0, help="ROS domain id, for --ros.")
    ] = 0,
    ros_connect: Annotated[
        str | None,
        typer.Option(
            "--ros-connect",
            metavar="ENDPOINT",
            help="Router of the ROS network. Default: the scene's router.",
        ),
    ] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(
            "--link", help="Link to publish; may be repeated. Default: all moving links, or the robot's."
        ),
    ] = None,
    base: Annotated[
        str,
        typer.Option(
            "--base", metavar="X,Y,Z[,QX,QY,QZ,QW]", help="Pose of the robot base in the world (m)."
        ),
    ] = "0,0,0",
    rate: Annotated[
        float,
        typer.Option("--rate", envvar="COMOTION_RATE", min=1, max=1000, help="Most instants per second."),
    ] = 200.0,
    batch: Annotated[
        float, typer.Option("--batch", min=0, max=1, help="Seconds of instants packed in one batch.")
    ] = 0.02,
    resolution: Annotated[
        float,
        typer.Option("--encoder", min=0, help="Resolution of the rotary encoders, rad. Default: 16 bits."),
    ] = 9.5873799e-05,
    linear: Annotated[
        float, typer.Option("--linear-encoder", min=0, help="Resolution of the linear encoders, m.")
    ] = 1e-5,
    speed: Annotated[float, typer.Option("--speed", min=0.01, help="Recorded seconds per second.")] = 1.0,
    original_stamps: Annotated[
        bool, typer.Option("--original-stamps", help="Keep the stamps of a log (serve with --clock event).")
    ] = False,
    name: source_options.Name = "proprioception",
    space: Annotated[str, typer.Option("--space", help="Coordinate space of the poses.")] = "world",
    scene: options.Scene = "default",
    connect: options.Connect = None,
    listen: options.Listen = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    insecure: options.Insecure = False,
    _log_level: options.Log = options.LogLevel.INFO,
    _metrics: options.Metrics = None,
) -> None:
    """Publish the 6-DoF poses of a robot's links from its joint positions."""
    from comotion_sources.proprioception import Encoders, Kinematics, process
    from comotion_sources.proprioception.packer import Packing

    loaded, links, truth, default_joints = _load(model, link)
    kinematics = Kinematics(loaded, links, _base(base), Encoders(angular=resolution, linear=linear))
    given = {"--joints": joints, "--csv": csv, "--bag": bag, "--ros": ros}
    reader = _joint_reader(given, default_joints, topic, domain, ros_connect, speed, original_stamps)
    process.run(
        kinematics,
        reader,
        packing=Packing(rate=rate, span=batch),
        truth=truth,
        name=name,
        space=space,
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
    )


def _load(
    model: str, links: list[str] | None
) -> tuple[Any, list[str] | None, dict[str, tuple[int, str]] | None, str | None]:
    """Return model, links, truth of the links and name of the default joint states."""
    from comotion_sources.proprioception import load_model

    if not model.startswith(_WORKCELL):
        return load_model(Path(model)), links, None, None
    from comotion_sources.workcell import Scene

    cell = Scene.named(model.removeprefix(_WORKCELL))
    chosen = links or list(cell.robot)
    numbers = {name: cell.object_of(name) for name in chosen}
    truth = {name: (number, cell.objects.get(number, "")) for name, number in numbers.items()}
    return cell.model, chosen, truth, "workcell"


def _base(text: str) -> "Extrinsics":
    from comotion_sources.calibration.model import Extrinsics

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 7):
        raise UserError(f"--base {text}: expected X,Y,Z or X,Y,Z,QX,QY,QZ,QW")
    return Extrinsics.from_quaternion(values[3:] or (0, 0, 0, 1), values[:3])


def _joint_reader(
    given: dict[str, Any],
    default_joints: str | None,
    topic: str | None,
    domain: int,
    ros_connect: str | None,
    speed: float,
    original_stamps: bool,
) -> "JointReader":
    from comotion_schemas.transport import SessionSettings
    from comotion_sources.proprioception.joint_logs import read_bag, read_csv
    from comotion_sources.proprioception.joint_readers import LogPlayback, RosTopic, SceneJoints

    chosen = {flag: value for flag, value in given.items() if value is not None}
    if not chosen and default_joints is not None:
        chosen = {"--joints": default_joints}
    if len(chosen) != 1:
        raise UserError(f"name one input: {', '.join(given)}")
    flag, value = next(iter(chosen.items()))
    if flag == "--joints":
        return SceneJoints(value)
    if flag == "--ros":
        settings = None if ros_connect is None else SessionSettings(connect=(ros_connect,))
        return RosTopic(value, domain, settings)
    if not value.exists():
        raise UserError(f"{value}: no such file")
    samples = read_csv(value) if flag == "--csv" else read_bag(value, topic)
    return LogPlayback(samples, speed, original_stamps)
