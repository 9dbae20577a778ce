"""The plan of a fleet: who claims which place, and who gives up what."""

import hypothesis.strategies as st
from hypothesis import given, settings

from comotion.runtime.standby.etcd import Entry
from comotion_deploy.fleet.entries import read_fleet
from comotion_deploy.fleet.plan import Agent, Fleet, Holder, Place, Scene, claims, may_change, releases


def fleet(scenes, agents, held=None, *, ready=True, draining=()):
    return Fleet(
        {f"s{k}": Scene(replicas=replicas) for k, replicas in enumerate(scenes)},
        {name: Agent(capacity, name in draining) for name, capacity in agents.items()},
        {Place(*place): Holder(agent, ready) for place, agent in (held or {}).items()},
    )


def settled(start):
    """Let all agents do their parts, at once and with every replica ready, until nothing changes."""
    for _ in range(100):
        taken = claims(start)
        given = [] if taken else releases(start)
        if not taken and not given:
            return start
        holders = {p: h for p, h in start.held().items() if p not in given}
        holders |= {place: Holder(agent, ready=True) for place, agent in taken.items()}
        start = Fleet(start.scenes, start.agents, holders)
    raise AssertionError("the plan never comes to rest")


fleets = st.builds(
    lambda scenes, capacities, draining: fleet(
        scenes, {f"a{k}": c for k, c in enumerate(capacities)}, draining={f"a{k}" for k in draining}
    ),
    st.lists(st.integers(1, 2), max_size=8),
    st.lists(st.integers(1, 6), max_size=4),
    st.sets(st.integers(0, 3), max_size=2),
)


@settings(max_examples=200)
@given(fleets)
def test_the_plan_comes_to_rest_within_all_capacities_and_with_replicas_apart(start):
    end = settled(start)
    loads = end.loads()
    assert all(loads[name] <= agent.capacity for name, agent in end.agents.items())
    assert all(loads[name] == 0 for name, agent in end.agents.items() if agent.draining)
    for name in end.scenes:
        agents = [holder.agent for place, holder in end.held().items() if place.scene == name]
        assert len(agents) == len(set(agents))
    capacity = sum(agent.capacity for agent in end.agents.values() if not agent.draining)
    assert len({place.scene for place in end.held()}) == min(len(end.scenes), capacity)


def test_a_draining_agent_waits_until_the_standby_is_ready():
    held = {("s0", 0): "a", ("s0", 1): "b"}
    agents = {"a": 1, "b": 1, "c": 1}
    assert releases(fleet([2], agents, held, draining={"a"})) == [Place("s0", 0)]
    assert releases(fleet([2], agents, held, draining={"a"}, ready=False)) == []


def changed(zero, one, agents=("a", "b")):
    """A scene whose options have changed; of each replica: ready, and with the changed options."""
    wanted = Scene(("--set", "window=7"))
    holders = {
        Place("s", k): Holder(agents[k], ready, version=wanted.version if new else "old")
        for k, (ready, new) in enumerate((zero, one))
        if agents[k]
    }
    return Fleet({"s": wanted}, {name: Agent(1) for name in agents if name}, holders)


READY, READY_WITH_IT, NOT_READY = (True, False), (True, True), (False, False)


def test_replicas_change_one_after_the_other():
    first, second = Place("s", 1), Place("s", 0)
    both = changed(READY, READY)
    assert (may_change(both, first), may_change(both, second)) == (True, False)
    under_way = changed(READY, NOT_READY)
    assert (may_change(under_way, first), may_change(under_way, second)) == (True, False)
    assert may_change(changed(READY, READY_WITH_IT), second)


def test_entries_that_somebody_else_wrote_are_left_out():
    class Written:
        def read_all(self, prefix):
            values = {
                "scenes/good": b'{"serve": ["--set", "window=7"], "also": [], "replicas": 9}',
                "scenes/bad": b"no json",
                "scenes/worse": b"[]",
                "agents/a": b'{"capacity": "3"}',
                "agents/b": b'{"capacity": null}',
                "agents/c": b'{"capacity": Infinity}',
                "places/good/0": b'{"agent": "a", "ready": true}',
                "places/good/x": b'{"agent": "a"}',
                "drain/a": b"",
            }
            return {
                prefix + name: Entry(value, created=1, changed=2, lease=0) for name, value in values.items()
            }

    read = read_fleet(Written())
    assert read.scenes == {"good": Scene(("--set", "window=7"), (), 2)}
    assert read.agents == {"a": Agent(3, draining=True)}
    assert read.holders == {Place("good", 0): Holder("a", ready=True, revision=2)}
