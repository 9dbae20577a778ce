"""``comotion source``: the group of source commands."""

import typer

from ..options import add
from .camera_sources import ExternalCamera, Klt
from .played_sources import Replay, Simulator
from .robot_sources import Proprioception, Workcell
from .ros2 import SourceRos2

app = typer.Typer(help="Publish tracked features to a scene.", no_args_is_help=True)
add(
    app,
    {
        "simulator": Simulator,
        "replay": Replay,
        "ros2": SourceRos2,
        "workcell": Workcell,
        "proprioception": Proprioception,
        "klt": Klt,
        "external-camera": ExternalCamera,
    },
)
