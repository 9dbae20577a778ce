"""``comotion source``: the group of source commands."""

import typer

from . import (
    source_external_camera,
    source_klt,
    source_proprioception,
    source_replay,
    source_ros2,
    source_simulator,
    source_workcell,
)

app = typer.Typer(help="Publish tracked features to a scene.", no_args_is_help=True)
app.command("simulator", epilog=source_simulator.EPILOG)(source_simulator.simulator)
app.command("replay", epilog=source_replay.EPILOG)(source_replay.replay)
app.command("ros2", epilog=source_ros2.EPILOG)(source_ros2.ros2)
app.command("workcell", epilog=source_workcell.EPILOG)(source_workcell.workcell)
app.command("proprioception", epilog=source_proprioception.EPILOG)(source_proprioception.proprioception)
app.command("klt", epilog=source_klt.EPILOG)(source_klt.klt)
app.command("external-camera", epilog=source_external_camera.EPILOG)(source_external_camera.external_camera)
