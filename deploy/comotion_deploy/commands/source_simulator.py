"""``comotion source simulator``: publishes a simulated scene with its truth."""

from enum import StrEnum
from typing import Annotated

import typer

from .. import options
from ..errors import UserError
from . import source_options

EPILOG = """
Examples:

  comotion source simulator --list

  comotion source simulator fig4_4 --loop

  comotion source simulator fig4_4 --rate 15,30,100   # three sources in one process

  comotion source simulator fig4_4 --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes

  comotion source simulator my_scene.toml --seed 7 --noise 2 --publish-sigma
"""


class SplitChoice(StrEnum):
    """How several sources divide a scene."""

    FEATURES = "features"
    OBJECTS = "objects"


def simulator(
    simulated: Annotated[
        str | None,
        typer.Argument(metavar="SCENE", help="A scene of --list, or a TOML file.", show_default=False),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the scenes of the package and end.")] = False,
    rate: Annotated[
        str | None,
        typer.Option(
            "--rate",
            envvar="COMOTION_RATE",
            metavar="HZ[,HZ...]",
            help="Rate, or one rate per source for several sources. Default: that of the scene.",
        ),
    ] = None,
    part: source_options.Part = None,
    split: Annotated[
        SplitChoice,
        typer.Option("--split", envvar="COMOTION_SPLIT", help="How several sources divide the scene."),
    ] = SplitChoice.FEATURES,
    seed: Annotated[
        int, typer.Option("--seed", envvar="COMOTION_SEED", min=0, help="Seed of the random numbers.")
    ] = 0,
    noise: Annotated[
        float, typer.Option("--noise", envvar="COMOTION_NOISE", min=0, help="Factor on the noise.")
    ] = 1.0,
    time_scale: Annotated[
        float, typer.Option("--time-scale", envvar="COMOTION_TIME_SCALE", help="2 plays twice as fast.")
    ] = 1.0,
    duration: source_options.Duration = None,
    loop: source_options.Loop = False,
    start_at: source_options.StartAt = "now",
    publish_sigma: Annotated[
        bool,
        typer.Option("--publish-sigma", envvar="COMOTION_PUBLISH_SIGMA", help="Publish the true noise."),
    ] = False,
    name: source_options.Names = None,
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
    """Publish a simulated scene, with its truth, as one source or several."""
    from comotion_sources import parts, player, simulator
    from comotion_sources.simulator import process

    if list_:
        _print_scenes()
        return
    if simulated is None:
        raise UserError("which scene? see 'comotion source simulator --list'")
    simulations = process.choose_sources(
        simulator.load_scene(simulated),
        part=parts.parse_part(part) if part else None,
        rates=parts.parse_rates(rate) if rate else None,
        seed=seed,
        noise=noise,
        time_scale=time_scale,
        split=split.value,
    )
    process.run(
        simulations,
        player.Schedule(start_at=player.parse_start(start_at), loop=loop, duration=duration),
        name=name,
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
        publish_sigma=publish_sigma,
    )


def _print_scenes() -> None:
    from comotion_sources import simulator

    for name in simulator.scene_names():
        spec = simulator.load_scene(name)
        rates = ", ".join(f"{rate:g}" for rate in spec.rates)
        print(f"{name:<12} {spec.dim}-D {spec.duration:>6g} s  {rates:>11} Hz  {spec.title}")
