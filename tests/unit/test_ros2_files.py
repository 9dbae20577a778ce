"""The configuration of RViz and the launch file: topics that exist. ROS itself is not here."""

import ast
from pathlib import Path

import yaml

from comotion_clients.ros2.messages import Converter

FOLDER = Path(__file__).parents[2] / "deploy" / "ros2"


def test_rviz_shows_topics_that_are_published():
    manager = yaml.safe_load((FOLDER / "comotion.rviz").read_text())["Visualization Manager"]
    kinds = Converter("default").kinds()
    shown = {
        one["Topic"]["Value"]: one["Class"].partition("/")[2] for one in manager["Displays"] if "Topic" in one
    }
    assert shown
    assert all(kinds[topic].endswith(f"/{display}") for topic, display in shown.items())


def test_the_launch_file_renames_what_rviz_shows():
    text = (FOLDER / "comotion.launch.py").read_text()
    ast.parse(text)
    for topic in ("features", "markers", "odometry"):
        assert f"/comotion/default/{topic}" in (FOLDER / "comotion.rviz").read_text()
        assert f'"{topic}"' in text
