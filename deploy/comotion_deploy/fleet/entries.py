"""The entries of a fleet in etcd: what they are called, and how they are read and written.

| key under ``comotion/v1/fleet/`` | value | lives |
|---|---|---|
| ``scenes/<scene>`` | serve, also, replicas | until ``comotion fleet remove`` |
| ``drain/<agent>`` | empty | until ``comotion fleet drain --undo`` |
| ``agents/<agent>`` | capacity | as long as the agent renews its lease |
| ``places/<scene>/<number>`` | agent, ready, version | as long as its agent renews its lease |
"""

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from comotion.runtime.standby import Entry, Etcd

from .plan import Agent, Fleet, Holder, Place, Scene

_PREFIX = "comotion/v1/fleet/"
Key = TypeVar("Key")
Made = TypeVar("Made")


def read_fleet(etcd: Etcd) -> Fleet:
    """Read all entries; those that cannot be read are left out."""
    entries = etcd.read_all(_PREFIX)
    names = {key.removeprefix(_PREFIX): entry for key, entry in entries.items()}
    draining = {name.removeprefix("drain/") for name in names if name.startswith("drain/")}
    scenes = _parsed(names, "scenes/", lambda name, value: (name, _scene(value)))
    agents = _parsed(
        names, "agents/", lambda name, value: (name, Agent(int(value["capacity"]), name in draining))
    )
    holders = _parsed(
        names,
        "places/",
        lambda name, value: (
            _place(name),
            Holder(
                str(value["agent"]),
                bool(value.get("ready")),
                names[f"places/{name}"].changed,
                str(value.get("version", "")),
            ),
        ),
    )
    return Fleet(scenes, agents, holders)


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
    key, value = f"{_PREFIX}agents/{agent}", _json({"capacity": capacity})
    if etcd.create(key, value, lease) is not None:
        return True
    entry = etcd.read(key)
    return entry is not None and entry.lease == lease


def claim(etcd: Etcd, place: Place, agent: str, lease: int) -> bool:
    """Claim a place; False if somebody holds it."""
    key = _key(place)
    if etcd.create(key, _json({"agent": agent, "ready": False}), lease) is not None:
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


def _place(name: str) -> Place:
    scene, _, number = name.rpartition("/")
    return Place(scene, int(number))


def _parsed(
    names: Mapping[str, Entry], folder: str, build: Callable[[str, dict[str, Any]], tuple[Key, Made]]
) -> dict[Key, Made]:
    """The entries of a folder of keys; those that somebody else has written in another form are left out."""
    parsed = {}
    for name, entry in names.items():
        if not name.startswith(folder):
            continue
        try:
            key, made = build(name.removeprefix(folder), json.loads(entry.value))
        except (ValueError, KeyError, TypeError, AttributeError):
            continue
        parsed[key] = made
    return parsed


def _scene(value: Mapping[str, Any]) -> Scene:
    serve, also = (tuple(str(word) for word in value.get(key, ())) for key in ("serve", "also"))
    return Scene(serve, also, max(1, min(int(value.get("replicas", 2)), 2)))


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value).encode()
