"""``comotion fleet``: many scenes over many hosts, by entries in etcd and one agent a host."""

import json
import threading
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options
from ..errors import UserError

if TYPE_CHECKING:
    from comotion.runtime.etcd import Etcd

EPILOG = """
Examples:

  comotion fleet --etcd http://etcd1:2379,http://etcd2:2379 --capacity 8   # on each host: an agent

  comotion fleet add kitchen --etcd http://etcd1:2379 -- --set window=7

  comotion fleet list

  comotion fleet drain host3   # before maintenance

COMOTION_ETCD holds the urls for all of them.
"""
app = typer.Typer(epilog=EPILOG, help="Serve many scenes on many hosts.")
EtcdUrls = Annotated[
    str | None,
    typer.Option("--etcd", envvar="COMOTION_ETCD", metavar="URL[,URL]", help="Members of the etcd cluster."),
]


@app.callback(invoke_without_command=True)
def fleet(
    ctx: typer.Context,
    etcd: EtcdUrls = None,
    capacity: Annotated[
        int | None,
        typer.Option("--capacity", envvar="COMOTION_CAPACITY", min=1, help="Replicas this host can run."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the agent. Default: the name of the host.")
    ] = None,
    connect: options.Connect = None,
    tls: options.Tls = None,
    log: Annotated[Path | None, typer.Option("--log", help="File for the lines of the processes.")] = None,
    ready_file: options.ReadyFile = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Run the agent of this host until Ctrl-C: it claims scenes in etcd, and serves them."""
    ctx.obj = etcd, tls
    if ctx.invoked_subcommand is not None:
        return
    if capacity is None:
        raise typer.BadParameter("an agent needs it", param_hint="--capacity")
    from comotion_schemas.component import stop_on_signals
    from comotion_schemas.readiness import announce_ready

    from ..fleet.agent import Agent
    from ..log_lines import LogLines

    agent = name or options.host_name()
    stop = threading.Event()
    served = [word for endpoint in connect or () for word in ("--connect", endpoint)]
    served += [] if tls is None else ["--tls", str(tls)]
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryDirectory(prefix="comotion-fleet-"))
        lines = stack.enter_context(LogLines([agent], log))
        stack.enter_context(stop_on_signals(stop))
        ready = ExitStack()
        stack.enter_context(ready)
        Agent(agent, capacity, _cluster(ctx, etcd, tls), served, Path(folder), lines).run(
            stop, lambda: ready.enter_context(announce_ready(ready_file))
        )


@app.command("add", epilog="Example:\n\n  comotion fleet add kitchen --one -- --method thesis")
def add(
    ctx: typer.Context,
    scene: Annotated[str, typer.Argument(help="Name of the scene.")],
    serve: Annotated[
        list[str] | None, typer.Argument(metavar="[-- OPTIONS]", help="Options of 'comotion serve'.")
    ] = None,
    also: Annotated[
        list[str] | None,
        typer.Option("--also", metavar="COMMAND", help="Another comotion command to run with the scene."),
    ] = None,
    one: Annotated[bool, typer.Option("--one", help="One replica, no standby.")] = False,
    change: Annotated[bool, typer.Option("--change", help="Change a scene that is there.")] = False,
    etcd: EtcdUrls = None,
    tls: options.Tls = None,
) -> None:
    """Add a scene to the fleet; agents with a free place serve it."""
    from comotion_schemas import Keys

    from ..fleet import entries
    from ..fleet.plan import Scene

    Keys(scene)  # a wrong name is an error here, not on a host
    wanted = Scene(tuple(serve or ()), tuple(also or ()), 1 if one else 2)
    if not entries.add_scene(_cluster(ctx, etcd, tls), scene, wanted, change=change):
        raise UserError(f"there is a scene {scene!r}; --change changes it")
    print(f"added {scene}")


@app.command("remove", epilog="Example:\n\n  comotion fleet remove kitchen")
def remove(
    ctx: typer.Context,
    scene: Annotated[str, typer.Argument(help="Name of the scene.")],
    etcd: EtcdUrls = None,
    tls: options.Tls = None,
) -> None:
    """Remove a scene; its replicas stop."""
    from ..fleet import entries

    if not entries.remove_scene(_cluster(ctx, etcd, tls), scene):
        raise UserError(f"there is no scene {scene!r}")
    print(f"removed {scene}")


@app.command(
    "drain", epilog="Example:\n\n  comotion fleet drain host3\n\n  comotion fleet drain host3 --undo"
)
def drain(
    ctx: typer.Context,
    agent: Annotated[str, typer.Argument(help="Name of the agent.")],
    undo: Annotated[bool, typer.Option("--undo", help="Let it take scenes again.")] = False,
    etcd: EtcdUrls = None,
    tls: options.Tls = None,
) -> None:
    """Move all scenes away from a host; those with a standby go on without a break."""
    from ..fleet import entries

    cluster = _cluster(ctx, etcd, tls)
    if agent not in entries.read_fleet(cluster).agents:
        raise UserError(f"there is no agent {agent!r}; 'comotion fleet list' shows all")
    entries.set_drain(cluster, agent, drain=not undo)
    print(f"{agent} {'may take scenes again' if undo else 'gives up its scenes'}")


@app.command("list", epilog="Examples:\n\n  comotion fleet list\n\n  comotion fleet list --json")
def show(
    ctx: typer.Context,
    etcd: EtcdUrls = None,
    tls: options.Tls = None,
    as_json: options.Json = False,
) -> None:
    """Show scenes with their replicas, and agents."""
    from ..fleet import entries, table

    found = entries.read_fleet(_cluster(ctx, etcd, tls))
    if as_json:
        print(json.dumps(table.as_json(found), indent=2))
        return
    from rich.console import Console

    Console().print(table.as_table(found))


def _cluster(ctx: typer.Context, urls: str | None, tls: Path | None = None) -> "Etcd":
    """The client; urls and certificate may stand before the subcommand or after it."""
    from comotion.runtime.etcd import Etcd
    from comotion_schemas.tls import load_tls

    group = ctx.obj or (None, None)
    found, folder = urls or group[0], tls or group[1]
    if not found:
        raise typer.BadParameter("urls of an etcd cluster are needed", param_hint="--etcd")
    files = None if folder is None else load_tls(folder)
    return Etcd(options.urls(found), files)
