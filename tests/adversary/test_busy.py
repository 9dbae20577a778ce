"""Row 9: a machine with three times the work it can do; messages wait, and none is dropped."""

import subprocess
import sys

import pytest

from .arena import SCENE

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]
_BUSY = "import time\nend = time.time() + 60\nwhile time.time() < end: sum(range(1000))"


def test_a_recorder_loses_nothing_beside_other_work(enter, tmp_path) -> None:
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
