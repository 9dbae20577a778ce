"""``comotion source simulator``: a scene whose truth is known."""

from enum import StrEnum
from typing import Annotated

import typer

from .. import options
from ..errors import UserError

EPILOG = """
Examples:

  comotion source simulator --list

  comotion source simulator fig4_4 --loop

  comotion source simulator fig4_4 --rate 15,30,100   # three sources in one process

  comotion source simulator fig4_4 --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes

  comotion source simulator my_scene.toml --seed 7 --noise 2 --publish-sigma
"""


class SplitChoice(StrEnum):
    """What several sources divide among them."""

    FEATURES = "features"
    OBJECTS = "objects"


def simulator(
    simulated: Annotated[
        str | None,
        typer.Argument(metavar="SCENE", help="A scene of --list, or a TOML file.", show_default=False),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the scenes that ship and end.")] = False,
    rate: Annotated[
        str | None,
        typer.Option(
            "--rate",
            envvar="COMOTION_RATE",
            metavar="HZ[,HZ...]",
            help="Rate; several make as many sources. Default: what the scene says.",
        ),
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            "--part",
            envvar="COMOTION_PART",
            metavar="K/N",
            help="Be the K-th of N sources that share the scene; each feature is seen by exactly one.",
        ),
    ] = None,
    split: Annotated[
        SplitChoice,
        typer.Option("--split", envvar="COMOTION_SPLIT", help="What several sources divide among them."),
    ] = SplitChoice.FEATURES,
    seed: Annotated[
        int, typer.Option("--seed", envvar="COMOTION_SEED", min=0, help="Seed of all that is random.")
    ] = 0,
    noise: Annotated[
        float, typer.Option("--noise", envvar="COMOTION_NOISE", min=0, help="Factor on the scene's noise.")
    ] = 1.0,
    time_scale: Annotated[
        float, typer.Option("--time-scale", envvar="COMOTION_TIME_SCALE", help="2 plays twice as fast.")
    ] = 1.0,
    duration: Annotated[
        float | None,
        typer.Option("--duration", envvar="COMOTION_DURATION", min=0, help="Stop after so many seconds."),
    ] = None,
    loop: Annotated[
        bool, typer.Option("--loop", envvar="COMOTION_LOOP", help="Start again at the end, as a new session.")
    ] = False,
    start_at: Annotated[
        str,
        typer.Option(
            "--start-at",
            envvar="COMOTION_START_AT",
            metavar="now|aligned|SECONDS",
            help="When the scene starts: now, at a multiple of its length, or at a Unix time. "
            "Sources in several processes need one of the latter two to be in phase.",
        ),
    ] = "now",
    publish_sigma: Annotated[
        bool,
        typer.Option("--publish-sigma", envvar="COMOTION_PUBLISH_SIGMA", help="Publish the true noise."),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            "--name",
            envvar="COMOTION_SOURCE_NAME",
            help="Name of the source; of several, NAME-1, NAME-2, ... Default: simulator.",
        ),
    ] = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    listen: options.Listen = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
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
        settings=options.session_settings(connect, listen),
        ready_file=ready_file,
        publish_sigma=publish_sigma,
    )


def _print_scenes() -> None:
    from comotion_sources import simulator

    for name in simulator.scene_names():
        spec = simulator.load_scene(name)
        rates = ", ".join(f"{rate:g}" for rate in spec.rates)
        print(f"{name:<12} {spec.dim}-D {spec.duration:>6g} s  {rates:>11} Hz  {spec.title}")
