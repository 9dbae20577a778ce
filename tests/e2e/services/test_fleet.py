"""A fleet of agents over real etcd: scenes are served, and go on when agents are lost, drained or added."""

import json
from contextlib import ExitStack

import pytest

from comotion.runtime.standby.etcd import Etcd
from comotion_clients.subscription import Subscription
from comotion_deploy.cli import run
from comotion_deploy.fleet.entries import add_scene, claim, read_fleet, register, say_leaving, say_ready
from comotion_deploy.fleet.plan import Place, Scene
from comotion_schemas import HypothesisUpdate

from ...builders import by_feature as labels
from ...builders import is_sorted_out
from ..etcd_server import NEEDS_ETCD
from ..waiting import until

pytestmark = NEEDS_ETCD
SCENES = 2
OPTIONS = ("--set", "window=7")


@pytest.fixture
def fleet(start, endpoint, etcd):
    """Start agents: ``fleet(*names)`` answers with their processes."""

    def start_all(*names):
        words = ("fleet", "--etcd", etcd.urls[0], "--capacity", 2 * SCENES, "--connect", endpoint)
        agents = {name: start(*words, "--name", name, ready=False) for name in names}
        for process in agents.values():
            process.wait_ready()
        return agents

    return start_all


@pytest.fixture
def sources(endpoint, track):
    """One tracker in each scene."""
    for k in range(SCENES):
        track(endpoint, scene=f"s{k}")


@pytest.fixture
def settled(session):
    """Wait until every scene is sorted out for 3 s, and a condition holds; labels by scene.

    A standby that begins now must have told the bodies apart before it is needed.
    """
    with ExitStack() as stack:
        scenes = [f"s{k}" for k in range(SCENES)]
        of = {name: stack.enter_context(Subscription(session, HypothesisUpdate, name)) for name in scenes}

        def wait(condition):
            last, stamps = {}, []

            def is_so():
                news = [(scene, update) for scene in of for _, update in of[scene].drain()]
                last.update(news)
                if news and len(last) == SCENES and all(map(is_sorted_out, last.values())) and condition():
                    stamps.append(min(update.stamp_ns for update in last.values()))
                return stamps and stamps[-1] - stamps[0] >= 3_000_000_000

            for subscription in of.values():
                subscription.drain()
            until(is_so)
            return {scene: labels(update) for scene, update in last.items()}

        yield wait


def served_by(client, agents):
    """Whether all places are held by these agents, and ready."""
    held = read_fleet(client).held().values()
    ready = len(held) == 2 * SCENES and all(holder.ready for holder in held)
    return ready and {holder.agent for holder in held} == set(agents)


def versions(client, scene):
    """The versions of a scene that are served."""
    return {holder.version for place, holder in read_fleet(client).held().items() if place.scene == scene}


def test_scenes_survive_a_killed_agent_a_new_one_and_a_drain(etcd, fleet, sources, settled, capsys):
    client, at = Etcd(etcd.urls), ("--etcd", etcd.urls[0])
    agents = fleet(*"abc")
    assert run(["fleet", "add", "s0", *at, "--", *OPTIONS]) == 0
    for k in range(1, SCENES):
        add_scene(client, f"s{k}", Scene(OPTIONS))
    before = settled(lambda: served_by(client, "abc"))

    loads = read_fleet(client).loads()
    lost = max("abc", key=lambda name: loads[name])
    agents[lost].kill()
    others = set("abc") - {lost}
    assert settled(lambda: served_by(client, others)) == before

    # With so few scenes, an agent is drained at once when the new one is there: that moves as much.
    fleet("d")
    drained = min(others)
    assert run(["fleet", *at, "drain", drained]) == 0
    assert settled(lambda: served_by(client, (others | {"d"}) - {drained})) == before
    capsys.readouterr()
    assert run(["fleet", "list", "--json", *at]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["agents"][drained] == {"replicas": 0, "capacity": 2 * SCENES, "draining": True}

    changed = Scene((*OPTIONS, "--set", "max_lag=0.2"))
    assert run(["fleet", "add", "s0", "--change", *at, "--", *changed.serve]) == 0
    assert settled(lambda: versions(client, "s0") == {changed.version}) == before

    assert run(["fleet", "remove", "s0", *at]) == 0
    until(lambda: not any(place.scene == "s0" for place in read_fleet(client).holders))


def test_of_two_ready_replicas_only_one_leaves(etcd):
    """A drain and a balance at the same time would leave the scene unserved."""
    client = Etcd(etcd.urls)
    lease, places = client.grant(60), (Place("s", 0), Place("s", 1))
    add_scene(client, "s", Scene())
    for place, agent in zip(places, "ab", strict=True):
        assert register(client, agent, 1, lease)
        assert claim(client, place, agent, lease)
        say_ready(client, place, agent, Scene().version, lease)
    held = read_fleet(client).held()
    left = [say_leaving(client, place, held[place], held[place.other], lease) for place in places]
    assert left == [True, False]
    assert [read_fleet(client).held()[place].ready for place in places] == [False, True]


def test_what_is_wrong_is_one_line(etcd, capsys):
    at = ("--etcd", etcd.urls[0])
    for arguments, reason in [
        (("remove", "nothing", *at), "there is no scene 'nothing'"),
        (("drain", "nobody", *at), "there is no agent 'nobody'"),
        (("add", "Wrong Name", *at), "a-z"),
        (("list",), "--etcd"),
        (("list", "--etcd", "http://127.0.0.1:1"), "etcd does not answer"),
    ]:
        assert run(["fleet", *arguments]) == 2
        printed = capsys.readouterr().err
        assert reason in printed
        assert len(printed.splitlines()) == 1
