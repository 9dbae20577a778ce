"""What one source does to a scene costs itself alone; the rows are those of docs/research/attacks.md."""

import os
import signal
import subprocess
import sys

import pytest

from comotion_tools.soak.attacks import NAME

from .arena import SCENE
from .conftest import BUSY
from .live import measure

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]
_BUSY = "import time\nend = time.time() + 60\nwhile time.time() < end: sum(range(1000))"
MOST_MB = 500
"""Two queues of 32 and 64 MB, their messages decoded, and 5000 trajectories."""


@pytest.mark.parametrize(
    ("attack", "named"),
    [
        ("spaces", ("over-budget", "limit")),
        ("new-spaces", ("limit",)),
        ("names", ("limit",)),
        ("carry", ("contradicts-space",)),
        ("large", ("limit",)),
        *((attack, ()) for attack in ("instants", "lie", "statuses", "tokens")),
        # Without certificates, somebody says that the scene is his.
        *((attack, ()) for attack in ("seize", "outrank")),
    ],
)
def test_an_attack_costs_its_source_alone(fair, attack, named) -> None:
    outcome = fair(attack)
    before, most, after = outcome.memory_mb
    assert attack not in {"large", "tokens"} or (most - before < MOST_MB and after - before < 60)
    assert attack not in {"seize", "outrank"} or outcome.updates > 50
    assert not named or outcome.names_the_attacker(*named), outcome


def test_many_instants_are_over_a_small_budget_on_any_machine(fair) -> None:
    """Storing may take 75 ms a second, a third for each; the attack takes 160 where this was written."""
    outcome = fair("many-instants", serve=("--set", "limits.processing=0.15"))
    assert outcome.names_the_attacker("over-budget"), outcome


def test_an_empty_batch_claims_no_space(enter):
    arena = enter(held=True)
    with arena.attacked_by("claim", 60.0):
        arena.wait(3.0)
        arena.begin()
    assert all(not one["rejected"] for one in arena.sessions() if one["source"] != NAME)


def test_after_that_the_space_is_at_rest(enter):
    arena = enter()
    arena.attack("carry", 3.0)
    assert arena.last is not None
    assert not arena.last.frames


@pytest.mark.parametrize("command", [("status",), ("watch", "--once")])
def test_what_is_shown_is_not_obeyed(enter, command):
    arena = enter()
    with arena.attacked_by("markup", 60.0):
        arena.wait(2.0)
        words = [sys.executable, "-m", "comotion_deploy", *command]
        where = ["--scene", SCENE, "--connect", arena.endpoint]
        env = {**os.environ, "COLUMNS": "200"}
        done = subprocess.run(
            [*words, *where], capture_output=True, text=True, timeout=60, check=False, env=env
        )
    assert "Traceback" not in done.stderr
    assert "hostile" in done.stdout
    assert all(line.isprintable() for line in (done.stdout + done.stderr).splitlines())
    log = arena.processes["service"].log.read_bytes().decode()
    assert all(line.isprintable() for line in log.split("\n"))


def test_a_service_that_starts_beside_a_token_has_the_scene(enter):
    arena = enter()
    with arena.attacked_by("seize", 120.0):
        service, before = arena.processes["service"], arena.last
        service.end()
        service.start()
        arena.until(lambda: arena.last.session != before.session)
        arena.wait(5.0)
        assert not service.has_ended()
    assert NAME not in {one.name for one in arena.last.sources}


def test_a_drifting_source_takes_no_ids_along_and_is_named(enter):
    outcome = enter().attack("drift", 20.0)
    assert ("drifts", NAME) in outcome.problems
    assert not outcome.blames_the_honest, outcome
    assert outcome.renamed == 0, outcome
    assert outcome.lost == 0, outcome


@pytest.mark.parametrize("ends_by", [signal.SIGTERM, signal.SIGKILL])
def test_accounts_across_an_outage_are_right_or_unknown(enter, ends_by):
    arena = enter()
    service, gone, stays = (arena.processes[name] for name in ("service", "left", "right"))
    session = gone.account["session"]
    service.end()
    arena.wait(3.0)
    gone.signal(ends_by)
    gone.end()
    arena.wait(2.0)
    service.start()
    before = arena.last.session
    arena.until(lambda: arena.last.session != before)
    arena.wait(5.0)
    stays.send({"do": "pause"})
    arena.until(lambda: bool(stays.account.get("paused")))
    arena.wait(4.0)
    accounts = {(one["source"], one["session"]): one for one in arena.sessions()}
    assert accounts["left", session]["lost"] is None
    mine = accounts["right", stays.account["session"]]
    assert mine["batches"] - mine["duplicates"] + mine["lost"] == stays.account["sent"]


def test_a_session_that_ends_while_the_service_listens_is_exact(enter):
    arena = enter()
    gone = arena.processes["left"]
    arena.wait(2.0)
    session = gone.account["session"]
    gone.end()
    arena.wait(4.0)
    mine = {(one["source"], one["session"]): one for one in arena.sessions()}["left", session]
    assert mine["lost"] == 0
    assert mine["batches"] >= gone.account["sent"]


def test_a_recorder_loses_nothing_beside_other_work(enter, tmp_path):
    arena = enter(also=("arm",))
    others = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(6)]
    try:
        words = [sys.executable, "-m", "comotion_deploy", "record", str(tmp_path / "take.mcap")]
        where = ["--duration", "20", "--scene", SCENE, "--connect", arena.endpoint]
        done = subprocess.run([*words, *where], capture_output=True, text=True, timeout=200, check=True)
    finally:
        for one in others:
            one.kill()
            one.wait()
    assert "lost" not in done.stdout + done.stderr


@pytest.mark.parametrize(("scene", "cores"), [("3d_4:60", 0.5), ("3d_4:300", 1.0), ("3d_async", 0.5)])
def test_live_is_as_good_as_offline_with_a_share_of_a_core(scene, cores):
    found = measure(scene, cores, 12.0)
    live, offline = found.nmi
    assert live > offline - 0.05, found
    assert found.updates >= 0.95 * found.due or os.getloadavg()[0] > BUSY, found
    assert found.back_s is not None, found
