"""``comotion ros2``: a scene as ROS 2 messages, without ROS."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import UserError, missing_extra

EPILOG = """
Examples:

  comotion ros2   # into the ROS network of the scene's router

  comotion ros2 --domain 5 --ros-connect tcp/192.168.1.20:7447

  comotion ros2 --bag bodies.mcap --duration 30   # no network: a bag

Topics: /tf (frames comotion/SCENE/ID), and below /comotion/SCENE: detections (vision_msgs/Detection3DArray),
odometry (nav_msgs/Odometry), features (sensor_msgs/PointCloud2: x, y, z, label, confidence), markers
(visualization_msgs/MarkerArray), joints (sensor_msgs/JointState).
"""


def ros2(
    domain: Annotated[
        int, typer.Option("--domain", envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain id.")
    ] = 0,
    ros_connect: Annotated[
        str | None,
        typer.Option(
            "--ros-connect",
            metavar="ENDPOINT",
            help="Router of the ROS network (rmw_zenohd). Default: the router of the scene.",
        ),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option(
            "--bag", envvar="COMOTION_BAG", metavar="FILE.mcap", help="Write a bag instead of publishing."
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", envvar="COMOTION_DURATION", min=0, help="s. Default: until Ctrl-C."),
    ] = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    names: options.BodyNames = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Publish a scene into a ROS 2 network that uses rmw_zenoh, or write it to a bag. ROS is not needed."""
    if bag is not None and ros_connect is not None:
        raise UserError("--ros-connect is only for publishing, not with --bag")
    if bag is not None and bag.exists():
        raise UserError(f"{bag}: exists")
    from comotion_clients.ros2.process import Ros2Options, run
    from comotion_schemas.naming import read_names
    from comotion_schemas.ros_types import store
    from comotion_schemas.transport import SessionSettings

    try:
        store()
    except ImportError as error:
        raise missing_extra("ros", error) from None
    how = Ros2Options(
        domain=domain,
        ros=None if ros_connect is None else SessionSettings(connect=(ros_connect,)),
        network=bag is None,
        bag=bag,
        duration=duration,
        ready_file=ready_file,
        names=read_names(names or ()),
    )
    try:
        sent = run(scene, options.session_settings(connect, tls=tls), how)
    except ImportError as error:
        raise missing_extra("record", error) from None
    for topic, count in sorted(sent.messages.items()):
        print(f"{topic}: {count}")
