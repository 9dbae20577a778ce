"""Row 4: Statuses that lie, that a terminal would obey, and that come in a storm."""

import os
import subprocess
import sys

import pytest

from .arena import SCENE

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


@pytest.mark.parametrize("attack", ["lie", "statuses"])
def test_statuses_cost_nobody_else(fair, attack) -> None:
    fair(attack)


@pytest.mark.parametrize("command", [("status",), ("watch", "--once")])
def test_what_is_shown_is_not_obeyed(enter, command) -> None:
    arena = enter()
    with arena.attacked_by("markup", 60.0):
        arena.watch(2.0)
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
