"""``comotion source ros2``: poses and labelled points of a ROS 2 topic."""

from dataclasses import dataclass

from ..options import Process, argument, option
from .ros2 import Ros


@dataclass(kw_only=True)
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
        from comotion_sources.ros2.process import Ros2Source, run

        self.require_ros()
        ros = self.ros_settings()
        run(
            Ros2Source(topic=self.topic, domain=self.domain, pattern=self.match, frame=self.frame, ros=ros),
            name=self.name,
            space=self.space,
            **self.where(),
        )
