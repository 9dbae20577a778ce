"""``comotion source workcell``: publishes the joint states of a simulated workcell."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import UserError
from . import source_options

EPILOG = """
Examples:

  comotion source workcell --list

  comotion source workcell truck   # publishes joint states; then, in other terminals:

  comotion source klt workcell:truck/a --name klt-a

  comotion source proprioception workcell:truck --name gripper

  comotion source workcell shelf --write-tum shelf-a --camera "a?size=320x240"
"""


def workcell(
    workcell_scene: Annotated[
        str | None,
        typer.Argument(metavar="SCENE", help="A workcell scene of --list.", show_default=False),
    ] = None,
    list_: Annotated[
        bool, typer.Option("--list", help="List the scenes with their cameras and end.")
    ] = False,
    rate: Annotated[
        float,
        typer.Option("--rate", envvar="COMOTION_RATE", min=1, max=1000, help="Joint states per second."),
    ] = 200.0,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            envvar="COMOTION_SEED",
            min=0,
            help="Seed of the timing (and of the cameras, if they have the same ?seed=).",
        ),
    ] = 0,
    duration: source_options.Duration = None,
    write_tum: Annotated[
        Path | None,
        typer.Option(
            "--write-tum",
            metavar="DIR",
            help="Write the frames of a camera as a TUM RGB-D folder instead, and end.",
        ),
    ] = None,
    camera: Annotated[
        str, typer.Option("--camera", help="The camera for --write-tum, with options after '?'.")
    ] = "a",
    name: Annotated[
        str,
        typer.Option(
            "--name",
            envvar="COMOTION_SOURCE_NAME",
            callback=options.name_of_certificate,
            help="Name of the stream of joint states. With a certificate: its name.",
        ),
    ] = "workcell",
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
    """Publish the joint states of a simulated workcell, which its cameras follow."""
    from comotion_sources.workcell import process
    from comotion_sources.workcell.scene import Scene

    if list_:
        _print_scenes()
        return
    if workcell_scene is None:
        raise UserError("which scene? 'comotion source workcell --list' names them")
    if write_tum is not None:
        _write(workcell_scene, camera, seed, duration, write_tum)
        return
    process.run(
        Scene.named(workcell_scene, seed),
        rate=rate,
        duration=duration,
        name=name,
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
    )


def _print_scenes() -> None:
    from comotion_sources.workcell.scene import Scene, scene_names

    for name in scene_names():
        scene = Scene.named(name)
        moving = ", ".join(scene.objects[number] for number in sorted(scene.objects) if number)
        print(f"{name:22} cameras {', '.join(scene.cameras)}; {scene.period:g} s; moving: {moving}")


def _write(scene: str, camera: str, seed: int, duration: float | None, folder: Path) -> None:
    from dataclasses import replace

    from comotion_sources.workcell.camera import WorkcellCamera, parse
    from comotion_sources.workcell.tum import write_tum

    spec = parse(f"{scene}/{camera}")
    spec = replace(spec, seed=seed or spec.seed, duration=duration or spec.duration)
    count = write_tum(WorkcellCamera(spec), folder)
    print(f"{count} frames in {folder}")
