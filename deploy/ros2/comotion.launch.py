"""RViz beside ``comotion ros2``, which passes a scene on: ``ros2 launch comotion.launch.py scene:=default``.

Needs rmw_zenoh (``RMW_IMPLEMENTATION=rmw_zenoh_cpp``), its router or that of the scene, and comotion[ros].
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Start both; they end together with the launch."""
    scene = LaunchConfiguration("scene")
    # A scene as a part of a topic: see comotion_clients/ros2/types.py.
    chunk = PythonExpression(["'", scene, "'.replace('-', '_')"])
    rviz = Path(__file__).with_name("comotion.rviz")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "scene", default_value="default", description="Name of the scene, which begins with a letter."
            ),
            DeclareLaunchArgument("frame", default_value="world", description="Space that RViz is fixed to."),
            ExecuteProcess(cmd=["comotion", "ros2", "--scene", scene], output="screen"),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(rviz), "-f", LaunchConfiguration("frame")],
                remappings=[
                    (f"/comotion/default/{topic}", ["/comotion/", chunk, f"/{topic}"])
                    for topic in ("features", "markers", "odometry")
                ],
            ),
        ]
    )
