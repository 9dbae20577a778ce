"""``comotion source ros2``: poses and labelled points of a ROS 2 topic."""

from typing import Annotated

import typer

from .. import options
from ..errors import missing_extra
from . import source_options

EPILOG = """
Examples:

  comotion source ros2 /tf --match "cup*" --frame world   # 6-DoF poses of trackers and motion capture

  comotion source ros2 /poses --ros-connect tcp/192.168.1.20:7447   # motion_capture_tracking

  comotion source ros2 /tracker/points   # PointCloud2 with x, y, z and id (or track_id, marker_id, label)
"""


def ros2(
    topic: Annotated[str, typer.Argument(metavar="TOPIC", help="Topic; its type is recognised.")],
    match: Annotated[
        str, typer.Option("--match", help="Frames or bodies to take, with * and ?.", metavar="PATTERN")
    ] = "*",
    frame: Annotated[
        str | None,
        typer.Option("--frame", help="Frame of the positions. Default: that of the first message."),
    ] = None,
    domain: Annotated[
        int, typer.Option("--domain", envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain id.")
    ] = 0,
    ros_connect: Annotated[
        str | None,
        typer.Option(
            "--ros-connect",
            metavar="ENDPOINT",
            help="Router of the ROS network. Default: the scene's router.",
        ),
    ] = None,
    name: source_options.Name = "ros2",
    space: Annotated[str, typer.Option("--space", help="Coordinate space of the features.")] = "world",
    scene: options.Scene = "default",
    connect: options.Connect = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.INFO,
    _metrics: options.Metrics = None,
) -> None:
    """Publish poses or labelled points of a ROS 2 topic over rmw_zenoh. ROS is not needed.

    Types: tf2_msgs/TFMessage, geometry_msgs/TransformStamped and PoseStamped, sensor_msgs/PointCloud2,
    motion_capture_tracking_interfaces/NamedPoseArray.
    """
    from comotion_schemas.ros_types import store
    from comotion_schemas.transport import SessionSettings
    from comotion_sources.ros2.process import Ros2Source, run

    try:
        store()
    except ImportError as error:
        raise missing_extra("ros", error) from None
    ros = None if ros_connect is None else SessionSettings(connect=(ros_connect,))
    run(
        Ros2Source(topic=topic, domain=domain, pattern=match, frame=frame, ros=ros),
        name=name,
        space=space,
        scene=scene,
        settings=options.session_settings(connect, tls=tls),
        ready_file=ready_file,
    )
