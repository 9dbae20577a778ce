"""``comotion fleet``: many scenes over many hosts, by entries in etcd and one agent a host."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import UserError
from ..network import Ready, Session, host_name, urls
from ..options import Command, Json, add, argument, as_function, flowing, option, setting

if TYPE_CHECKING:
    from comotion.runtime.standby.etcd import Etcd

    from ..fleet.plan import Holder

EPILOG = """
Examples:
  comotion fleet --etcd http://etcd1:2379,http://etcd2:2379 --capacity 8   # on each host: an agent
  comotion fleet add kitchen --etcd http://etcd1:2379 -- --set window=7
  comotion fleet list
  comotion fleet drain host3   # before maintenance

COMOTION_ETCD holds the urls for all of them.
"""


class Cluster(Command):
    """Options of each of these commands."""

    etcd: str | None = setting(None, "Members of the etcd cluster.", metavar="URL[,URL]")
    tls: Path | None = setting(
        None, "Connect with the certificate in this folder, made by 'comotion pki issue'.", metavar="DIR/NAME"
    )

    def cluster(self) -> "Etcd":
        """Return the client; urls and certificate may stand before the subcommand or after it."""
        from comotion.runtime.standby.etcd import Etcd
        from comotion_schemas.tls import load_tls

        group = {} if self.ctx.parent is None else self.ctx.parent.params
        given, folder = self.etcd or group.get("etcd"), self.tls or group.get("tls")
        if not given:
            raise typer.BadParameter("urls of an etcd cluster are needed", param_hint="--etcd")
        return Etcd(urls(given), None if folder is None else load_tls(folder))


class RunAgent(Cluster, Ready, Session):
    """Run the agent of this host until Ctrl-C: it claims scenes in etcd, and serves them."""

    capacity: int | None = setting(None, "Replicas this host can run.", min=1)
    name: str | None = option(None, "Name of the agent. Default: the name of the host.")
    log: Path | None = option(None, "File for the lines of the processes.")

    def run(self) -> None:
        """Run the agent, unless there is a subcommand."""
        if self.ctx.invoked_subcommand is not None:
            return
        if self.capacity is None:
            raise typer.BadParameter("an agent needs it", param_hint="--capacity")
        from ..fleet.agent import run_agent

        serve = [word for endpoint in self.connect or () for word in ("--connect", endpoint)]
        serve += [] if self.tls is None else ["--tls", str(self.tls)]
        name = self.name or host_name()
        self.call(run_agent, name=name, etcd=self.cluster(), options=serve)


class Add(Cluster):
    """Add a scene to the fleet; agents with a free place serve it."""

    epilog = "Example:\n  comotion fleet add kitchen --one -- --method thesis"

    scene: str = argument(..., "SCENE", "Name of the scene.")
    serve: list[str] | None = argument(None, "-- OPTIONS", "Options of 'comotion serve'.")
    also: list[str] | None = option(
        None, "Another comotion command to run with the scene.", metavar="COMMAND"
    )
    one: bool = option(False, "One replica, no standby.")
    change: bool = option(False, "Change a scene that is there.")

    def run(self) -> None:
        """Add it."""
        from comotion_schemas import Keys

        from ..fleet import entries
        from ..fleet.plan import Scene

        Keys(self.scene)  # a wrong name is an error here, not on a host
        wanted = Scene(tuple(self.serve or ()), tuple(self.also or ()), 1 if self.one else 2)
        if not entries.add_scene(self.cluster(), self.scene, wanted, change=self.change):
            raise UserError(f"there is a scene {self.scene!r}; --change changes it")
        print(f"added {self.scene}")


class Remove(Cluster):
    """Remove a scene; its replicas stop."""

    epilog = "Example:\n  comotion fleet remove kitchen"

    scene: str = argument(..., "SCENE", "Name of the scene.")

    def run(self) -> None:
        """Remove it."""
        from ..fleet import entries

        if not entries.remove_scene(self.cluster(), self.scene):
            raise UserError(f"there is no scene {self.scene!r}")
        print(f"removed {self.scene}")


class Drain(Cluster):
    """Move all scenes away from a host; those with a standby go on without a break."""

    epilog = "Example:\n  comotion fleet drain host3\n  comotion fleet drain host3 --undo"

    agent: str = argument(..., "AGENT", "Name of the agent.")
    undo: bool = option(False, "Let it take scenes again.")

    def run(self) -> None:
        """Drain it."""
        from ..fleet import entries

        cluster = self.cluster()
        if self.agent not in entries.read_fleet(cluster).agents:
            raise UserError(f"there is no agent {self.agent!r}; 'comotion fleet list' shows all")
        entries.set_drain(cluster, self.agent, drain=not self.undo)
        print(f"{self.agent} {'may take scenes again' if self.undo else 'gives up its scenes'}")


class Listing(Json, Cluster):
    """Show scenes with their replicas, and agents."""

    epilog = "Examples:\n  comotion fleet list\n  comotion fleet list --json"

    def run(self) -> None:
        """Show them."""
        from rich.table import Table

        from ..fleet.entries import read_fleet
        from ..fleet.plan import Place

        fleet = read_fleet(self.cluster())
        held, loads = fleet.held(), fleet.loads()
        content: dict[str, dict[str, Any]] = {"scenes": {}, "agents": {}}
        scenes = Table("scene", "replicas", "options")
        for name, scene in sorted(fleet.scenes.items()):
            replicas = [held.get(Place(name, k)) for k in range(scene.replicas)]
            content["scenes"][name] = {
                "serve": scene.serve,
                "also": scene.also,
                "replicas": [
                    holder and {"agent": holder.agent, "ready": holder.ready} for holder in replicas
                ],
            }
            scenes.add_row(name, ", ".join(map(_replica, replicas)), " ".join(scene.serve))
        agents = Table("agent", "replicas", "capacity", "")
        for name, agent in sorted(fleet.agents.items()):
            content["agents"][name] = {"replicas": loads[name], **vars(agent)}
            note = "draining" if agent.draining else ""
            agents.add_row(name, str(loads[name]), str(agent.capacity), note)
        self.show(content, scenes, agents)


app = typer.Typer(epilog=flowing(EPILOG), help="Serve many scenes on many hosts.")
app.callback(invoke_without_command=True)(as_function(RunAgent))
add(app, {"add": Add, "remove": Remove, "drain": Drain, "list": Listing})


def _replica(holder: "Holder | None") -> str:
    if holder is None:
        return "[red]none[/red]"
    return holder.agent if holder.ready else f"{holder.agent} (starting or leaving)"
