"""``comotion ros2`` and ``comotion source ros2``: to and from a ROS 2 network, without ROS."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError
from ..network import Present, Process
from ..options import Command, argument, option, setting
from .look import BodyNames

if TYPE_CHECKING:
    from comotion_schemas.transport import SessionSettings


class Ros(Command):
    """Options of a command that is part of a ROS network."""

    domain: int = option(0, "ROS domain id.", env="ROS_DOMAIN_ID", min=0, max=232)
    ros_connect: str | None = option(
        None, "Router of the ROS network (rmw_zenohd). Default: the router of the scene.", metavar="ENDPOINT"
    )

    def ros_settings(self) -> "SessionSettings | None":
        """Return the settings of the session with the ROS network; None: the scene's session.

        Raises
        ------
        ImportError
            If the types of ROS messages are not installed.
        """
        from comotion_schemas.ros_types import store
        from comotion_schemas.transport import SessionSettings

        store()
        return None if self.ros_connect is None else SessionSettings(connect=(self.ros_connect,))


class Ros2(Ros, BodyNames, Present):
    """Publish a scene into a ROS 2 network that uses rmw_zenoh, or write it to a bag. ROS is not needed."""

    epilog = """
Examples:
  comotion ros2   # into the ROS network of the scene's router
  comotion ros2 --domain 5 --ros-connect tcp/192.168.1.20:7447
  comotion ros2 --bag bodies.mcap --duration 30   # no network: a bag

Topics: /tf (frames comotion/SCENE/ID), and below /comotion/SCENE: detections (vision_msgs/Detection3DArray),
odometry (nav_msgs/Odometry), features (sensor_msgs/PointCloud2: x, y, z, label, confidence, rgb), markers
(visualization_msgs/MarkerArray), joints (sensor_msgs/JointState).
"""

    bag: Path | None = setting(None, "Write a bag instead of publishing.", metavar="FILE.mcap")
    duration: float | None = setting(
        None, "Stop after this time. Default: on Ctrl-C.", min=0, metavar="SECONDS"
    )

    def run(self) -> None:
        """Publish until stopped."""
        if self.bag is not None and self.ros_connect is not None:
            raise UserError("--ros-connect is only for publishing, not with --bag")
        from comotion_clients.ros2.process import run

        sent = self.call(run, ros=self.ros_settings(), names=self.names(), **self.where())
        for topic, count in sorted(sent.items()):
            print(f"{topic}: {count}")


class SourceRos2(Ros, Process):
    """Publish poses or labelled points of a ROS 2 topic over rmw_zenoh. ROS is not needed.

    Types: tf2_msgs/TFMessage, geometry_msgs/TransformStamped and PoseStamped, sensor_msgs/PointCloud2,
    motion_capture_tracking_interfaces/NamedPoseArray.
    """

    epilog = """
Examples:
  comotion source ros2 /tf --match "cup*" --frame world   # 6-DoF poses of trackers and motion capture
  comotion source ros2 /poses --ros-connect tcp/192.168.1.20:7447   # motion_capture_tracking
  comotion source ros2 /tracker/points   # PointCloud2 with x, y, z and id (or track_id, marker_id, label)
"""
    name = "ros2"

    topic: str = argument(..., "TOPIC", "Topic; its type is recognised.")
    match: str = option("*", "Frames or bodies to take, with * and ?.", metavar="PATTERN")
    frame: str | None = option(None, "Frame of the positions. Default: that of the first message.")
    space: str = option("world", "Coordinate space of the features.")

    def run(self) -> None:
        """Publish until stopped."""
        from comotion_sources.ros2.process import run

        self.call(run, pattern=self.match, ros=self.ros_settings(), **self.where())
