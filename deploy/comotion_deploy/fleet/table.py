"""Shows the entries of a fleet as a table or a JSON document."""

from typing import Any

from rich.console import Group
from rich.table import Table

from .plan import Fleet, Place


def as_json(fleet: Fleet) -> dict[str, Any]:
    """Scenes with their replicas, and agents with their loads, as plain values."""
    held, loads = fleet.held(), fleet.loads()
    return {
        "scenes": {
            name: {
                "serve": list(scene.serve),
                "also": list(scene.also),
                "replicas": [
                    {"agent": holder.agent, "ready": holder.ready}
                    if (holder := held.get(Place(name, k)))
                    else None
                    for k in range(scene.replicas)
                ],
            }
            for name, scene in sorted(fleet.scenes.items())
        },
        "agents": {
            name: {"replicas": loads[name], "capacity": agent.capacity, "draining": agent.draining}
            for name, agent in sorted(fleet.agents.items())
        },
    }


def as_table(fleet: Fleet) -> Group:
    """The same as two tables."""
    content = as_json(fleet)
    scenes = Table("scene", "replicas", "options")
    for name, scene in content["scenes"].items():
        scenes.add_row(name, ", ".join(map(_replica, scene["replicas"])), " ".join(scene["serve"]))
    agents = Table("agent", "replicas", "capacity", "")
    for name, agent in content["agents"].items():
        note = "draining" if agent["draining"] else ""
        agents.add_row(name, str(agent["replicas"]), str(agent["capacity"]), note)
    return Group(scenes, agents)


def _replica(replica: dict[str, Any] | None) -> str:
    if replica is None:
        return "[red]none[/red]"
    return replica["agent"] if replica["ready"] else f"{replica['agent']} (starting or leaving)"
