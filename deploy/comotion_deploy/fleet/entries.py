"""The entries of a fleet in etcd: what they are called, and how they are read and written.

| key under ``comotion/v1/fleet/`` | value | lives |
|---|---|---|
| ``scenes/<scene>`` | serve, also, replicas | until ``comotion fleet remove`` |
| ``drain/<agent>`` | empty | until ``comotion fleet drain --undo`` |
| ``agents/<agent>`` | capacity | as long as the agent renews its lease |
| ``places/<scene>/<number>`` | agent, ready, version | as long as its agent renews its lease |
"""

import json
from collections.abc import Mapping
from typing import Any

from comotion.runtime.standby.etcd import Etcd

from .plan import Agent, Fleet, Holder, Place, Scene

_PREFIX = "comotion/v1/fleet/"


def read_fleet(etcd: Etcd) -> Fleet:
    """Read all entries; those that somebody else has written in another form are left out."""
    fleet, draining = Fleet(), set[str]()
    for key, entry in etcd.read_all(_PREFIX).items():
        folder, _, name = key.removeprefix(_PREFIX).partition("/")
        if folder == "drain":
            draining.add(name)
            continue
        try:
            _enter(fleet, folder, name, json.loads(entry.value), entry.changed)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
            continue
    agents = {name: Agent(agent.capacity, name in draining) for name, agent in fleet.agents.items()}
    return Fleet(fleet.scenes, agents, fleet.holders)


def _enter(fleet: Fleet, folder: str, name: str, value: dict[str, Any], changed: int) -> None:
    """Take up one entry."""
    match folder:
        case "scenes":
            serve, also = (tuple(str(word) for word in value.get(key, ())) for key in ("serve", "also"))
            fleet.scenes[name] = Scene(serve, also, max(1, min(int(value.get("replicas", 2)), 2)))
        case "agents":
            fleet.agents[name] = Agent(int(value["capacity"]))
        case "places":
            scene, _, number = name.rpartition("/")
            fields = str(value["agent"]), bool(value.get("ready")), changed, str(value.get("version", ""))
            fleet.holders[Place(scene, int(number))] = Holder(*fields)


def add_scene(etcd: Etcd, name: str, scene: Scene, *, change: bool = False) -> bool:
    """Add a scene; False if there is one of this name and it is not to be changed."""
    value = _json(vars(scene))
    if change:
        etcd.put(f"{_PREFIX}scenes/{name}", value)
        return True
    return etcd.create(f"{_PREFIX}scenes/{name}", value) is not None


def remove_scene(etcd: Etcd, name: str) -> bool:
    """Remove a scene; False if there is none of this name."""
    return etcd.delete(f"{_PREFIX}scenes/{name}")


def set_drain(etcd: Etcd, agent: str, *, drain: bool) -> None:
    """Say that an agent gives up its replicas, or may take some again."""
    if drain:
        etcd.put(f"{_PREFIX}drain/{agent}", b"")
    else:
        etcd.delete(f"{_PREFIX}drain/{agent}")


def register(etcd: Etcd, agent: str, capacity: int, lease: int) -> bool:
    """Enter an agent; False if another one of this name lives."""
    return _hold(etcd, f"{_PREFIX}agents/{agent}", {"capacity": capacity}, lease)


def claim(etcd: Etcd, place: Place, agent: str, lease: int) -> bool:
    """Claim a place; False if somebody holds it."""
    return _hold(etcd, _key(place), {"agent": agent, "ready": False}, lease)


def _hold(etcd: Etcd, key: str, value: Mapping[str, Any], lease: int) -> bool:
    """Write an entry that is not there, or hold it already."""
    if etcd.create(key, _json(value), lease) is not None:
        return True
    entry = etcd.read(key)
    return entry is not None and entry.lease == lease


def say_ready(etcd: Etcd, place: Place, agent: str, version: str, lease: int) -> None:
    """Say with which version of its scene the replica of a place is ready, if the agent still holds it."""
    entry = etcd.read(_key(place))
    if entry is not None and entry.lease == lease:
        value = {"agent": agent, "ready": True, "version": version}
        etcd.replace(_key(place), entry.created, _json(value), lease)


def say_leaving(etcd: Etcd, place: Place, holder: Holder, partner: Holder | None, lease: int) -> bool:
    """Say that the replica of a place is about to leave; False if the other one's place has changed.

    So of two replicas that see each other ready only one leaves.
    """
    value = _json({"agent": holder.agent, "ready": False})
    if partner is not None:
        return etcd.put_while(_key(place.other), partner.revision, _key(place), value, lease)
    etcd.put(_key(place), value, lease)
    return True


def release(etcd: Etcd, place: Place, lease: int) -> None:
    """Give up a place that is held with a lease."""
    entry = etcd.read(_key(place))
    if entry is not None and entry.lease == lease:
        etcd.delete(_key(place))


def _key(place: Place) -> str:
    return f"{_PREFIX}places/{place.scene}/{place.number}"


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value).encode()
