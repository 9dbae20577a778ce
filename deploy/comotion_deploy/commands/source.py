"""``comotion source``: the group of source commands."""

import typer

from ..options import add
from .source_external_camera import ExternalCamera
from .source_klt import Klt
from .source_proprioception import Proprioception
from .source_replay import Replay
from .source_ros2 import SourceRos2
from .source_simulator import Simulator
from .source_workcell import Workcell

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
