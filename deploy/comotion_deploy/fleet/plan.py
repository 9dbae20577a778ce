"""Plans which agent should claim which free place, and which places should be given up.

Pure functions: every agent computes the same plan from the same entries and does its own part of it.
"""

import json
import zlib
from collections import Counter
from dataclasses import asdict, dataclass, field, replace

# A difference of one is no imbalance: with an odd number of replicas somebody has one more.
_IMBALANCE = 2


@dataclass(frozen=True)
class Scene:
    """A scene to serve."""

    serve: tuple[str, ...] = ()  # options of ``comotion serve``
    also: tuple[str, ...] = ()  # other comotion commands that run once, beside the first replica
    replicas: int = 2  # 1, or 2 for a standby on another host

    @property
    def version(self) -> str:
        """Digest of all fields."""
        return f"{zlib.crc32(json.dumps(asdict(self)).encode()):08x}"


@dataclass(frozen=True)
class Agent:
    """An agent: how many replicas its host can run, and whether it gives them up."""

    capacity: int
    draining: bool = False


@dataclass(frozen=True, order=True)
class Place:
    """Where a replica of a scene runs: number 0 or 1."""

    scene: str
    number: int

    @property
    def other(self) -> "Place":
        """That of the scene's other replica."""
        return Place(self.scene, 1 - self.number)


@dataclass(frozen=True)
class Holder:
    """The agent that holds a place, whether its replica is ready and stays, and the revision that says so.

    `version` is that of the scene with which the replica is ready.
    """

    agent: str
    ready: bool = False
    revision: int = 0
    version: str = ""


@dataclass(frozen=True)
class Fleet:
    """All entries: scenes and agents by name, holders by place."""

    scenes: dict[str, Scene] = field(default_factory=dict)
    agents: dict[str, Agent] = field(default_factory=dict)
    holders: dict[Place, Holder] = field(default_factory=dict)

    def places(self) -> list[Place]:
        """All places that the scenes ask for."""
        return [Place(name, k) for name, scene in self.scenes.items() for k in range(scene.replicas)]

    def held(self) -> dict[Place, Holder]:
        """The places that the scenes ask for and an agent that lives holds."""
        wanted = set(self.places())
        return {p: h for p, h in self.holders.items() if p in wanted and h.agent in self.agents}

    def loads(self) -> Counter[str]:
        """Replicas of each agent, 0 included."""
        loads = Counter(dict.fromkeys(self.agents, 0))
        loads.update(holder.agent for holder in self.held().values())
        return loads


def claims(fleet: Fleet) -> dict[Place, str]:
    """Free places, and the agents that should claim them.

    First every scene gets one replica, then the standbys. Each place goes to the agent with the fewest
    replicas that has a free place and does not hold the scene's other place.
    """
    held, loads = fleet.held(), fleet.loads()
    agents = {place: holder.agent for place, holder in held.items()}
    claimed: dict[Place, str] = {}
    free = [place for place in fleet.places() if place not in agents]
    served = {place.scene for place in agents}
    for place in sorted(free, key=lambda p: (p.scene in served or p.number > 0, p.scene, p.number)):
        others = {agent for other, agent in agents.items() if other.scene == place.scene}
        hosts = [
            name
            for name, agent in fleet.agents.items()
            if not agent.draining and loads[name] < agent.capacity and name not in others
        ]
        if hosts:
            chosen = min(hosts, key=lambda name: (loads[name], name))
            claimed[place] = agents[place] = chosen
            loads[chosen] += 1
    return claimed


def releases(fleet: Fleet) -> list[Place]:
    """Places that their holders should give up: those of draining agents, or one for balance.

    A place is given up only if the scene's other replica is ready and takes over, or, on draining, if there
    is no other replica and another agent has a free place.
    """
    if claims(fleet):
        return []
    draining = [place for place, holder in fleet.held().items() if fleet.agents[holder.agent].draining]
    leaving = [place for place in draining if _can_leave(fleet, place)]
    return leaving or _for_balance(fleet)


def may_change(fleet: Fleet, place: Place) -> bool:
    """Whether the replica of a place may start anew with the changed options of its scene.

    The replicas change one after the other, number 1 first: who is ready stops only while the other one is
    ready, number 0 only when the other one is ready with the changed options.
    """
    held = fleet.held()
    if not held[place].ready:
        return True
    partner = held.get(place.other)
    if partner is None:
        return place.other not in claims(fleet)
    changed = place.number == 1 or partner.version == fleet.scenes[place.scene].version
    return changed and partner.ready


def _can_leave(fleet: Fleet, place: Place) -> bool:
    if _partner_ready(fleet, place):
        return True
    without = {other: holder for other, holder in fleet.holders.items() if other != place}
    return place.other not in fleet.held() and place in claims(replace(fleet, holders=without))


def _partner_ready(fleet: Fleet, place: Place) -> bool:
    partner = fleet.held().get(place.other)
    return partner is not None and partner.ready and not fleet.agents[partner.agent].draining


def _for_balance(fleet: Fleet) -> list[Place]:
    """One replica to move from the agent with the most to the one with the fewest."""
    held, loads = fleet.held(), fleet.loads()
    if not all(holder.ready for holder in held.values()):
        return []  # something is on its way already
    hosts = [n for n, agent in fleet.agents.items() if not agent.draining and loads[n] < agent.capacity]
    if not hosts:
        return []
    least = min(hosts, key=lambda name: (loads[name], name))
    most = max(fleet.agents, key=lambda name: (loads[name], name))
    if loads[most] - loads[least] < _IMBALANCE:
        return []
    served = {place.scene for place, holder in held.items() if holder.agent == least}
    movable = [
        place
        for place, holder in sorted(held.items())
        if holder.agent == most and place.scene not in served and _partner_ready(fleet, place)
    ]
    return movable[:1]
