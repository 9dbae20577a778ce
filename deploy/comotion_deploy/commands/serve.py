"""``comotion serve``: the fusion service of a scene."""

import gc
import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..fusion_options import fusion_config
from . import linked_cameras

EPILOG = """
Examples:

  comotion serve

  comotion serve --method thesis --set thesis.sigma_switch=0.01 --set thesis.v_move=null

  comotion serve --resume   # go on where the last one has stopped: the same objects, the same ids

  comotion serve --scene workcell --state workcell.state --connect tcp/192.168.1.10:7447

  comotion serve --camera door=door.yaml,door-extrinsics.toml   # links to bodies of a depth camera

  comotion serve --scene a --standby --etcd http://etcd1:2379,http://etcd2:2379   # on two hosts

  comotion serve --clock event   # for recordings with stamps in the past
"""


class ClockChoice(StrEnum):
    """Clock of the service."""

    WALL = "wall"
    EVENT = "event"


def serve(
    ctx: typer.Context,
    method: options.Method = None,
    assignments: options.Assignments = None,
    camera: linked_cameras.Cameras = None,
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            envvar="COMOTION_STATE",
            metavar="FILE",
            dir_okay=False,
            help="Go on from this file, and keep hypotheses and their ids in it. Default: a new scene, kept "
            "in a file for the scene in the user's state folder, ~/.local/state/comotion.",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            envvar="COMOTION_RESUME",
            help="Go on from the scene's file. 'up', 'fleet', the image and the units of systemd do.",
        ),
    ] = False,
    no_state: Annotated[
        bool,
        typer.Option(
            "--no-state", envvar="COMOTION_NO_STATE", help="Keep nothing: ids start anew with each process."
        ),
    ] = False,
    state_interval: Annotated[
        float,
        typer.Option("--state-interval", envvar="COMOTION_STATE_INTERVAL", min=0.1, help="s between writes."),
    ] = 1.0,
    clock: Annotated[
        ClockChoice,
        typer.Option(
            "--clock", envvar="COMOTION_CLOCK", help="The wall clock, or the newest stamp received."
        ),
    ] = ClockChoice.WALL,
    correct_clocks: Annotated[
        bool,
        typer.Option(
            "--correct-clocks",
            envvar="COMOTION_CORRECT_CLOCKS",
            help="Shift the stamps of sources whose hosts' clocks differ from this one's, as measured.",
        ),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            "--name",
            envvar="COMOTION_SERVICE_NAME",
            callback=options.name_of_certificate,
            help="Name of this service. Default: fusion, with --standby fusion-HOST; or the certificate's.",
        ),
    ] = None,
    standby: Annotated[
        bool,
        typer.Option(
            "--standby",
            envvar="COMOTION_STANDBY",
            help="Be one of several replicas of the scene; one speaks, the others follow. Needs --etcd.",
        ),
    ] = False,
    etcd: Annotated[
        str | None,
        typer.Option(
            "--etcd",
            envvar="COMOTION_ETCD",
            metavar="URL[,URL]",
            help="Members of the etcd cluster that elects the replica that speaks; https takes --tls.",
        ),
    ] = None,
    lease: Annotated[
        int,
        typer.Option(
            "--lease", envvar="COMOTION_LEASE", min=2, help="s until a lost host loses the scene in etcd."
        ),
    ] = 2,
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
    """Fuse the sources of a scene and publish its hypotheses at a fixed period."""
    # Threads of parallel kernels spin for some tens of microseconds before they sleep.
    os.environ.setdefault("GOMP_SPINCOUNT", "50000")
    # All that is imported stays: looking for garbage in it took .3 s of a start of 2.1 s.
    gc.disable()
    from comotion.runtime import server
    from comotion.runtime.state_file import default_path

    gc.freeze()
    gc.enable()

    if standby != bool(etcd):
        raise typer.BadParameter("--standby and --etcd go together", param_hint="--standby")
    name = name or (f"fusion-{options.host_name()}" if standby else server.DEFAULT_NAME)
    # Replicas of one scene may run on one machine.
    replica = f".{name}" if standby else ""
    kept = state or default_path(f"{scene}{replica}", [*(connect or ()), *(listen or ())])
    settings = options.session_settings(connect, listen, tls, insecure=insecure)
    server.serve(
        server.ServeOptions(
            config=linked_cameras.with_cameras(fusion_config(ctx, method, assignments), camera),
            scene=scene,
            name=name,
            settings=settings,
            clock=clock.value,
            state=None if no_state else kept,
            resume=resume or state is not None,
            state_interval=state_interval,
            ready_file=ready_file,
            etcd=options.urls(etcd),
            etcd_tls=settings.tls,
            lease=lease,
            correct_clocks=correct_clocks,
        )
    )
