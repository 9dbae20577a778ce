"""Row 9: a machine with three times the work it can do; messages wait, and none is dropped."""

import subprocess
import sys

import pytest

from .arena import SCENE
from .live import measure

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


@pytest.mark.parametrize(("scene", "cores"), [("3d_4:60", 0.5), ("3d_4:300", 1.0), ("3d_async", 0.5)])
def test_live_is_as_good_as_offline_with_a_share_of_a_core(scene, cores) -> None:
    found = measure(scene, cores, 12.0)
    live, offline = found.nmi
    assert live > offline - 0.05, found
    assert found.updates >= 0.95 * found.due, found
    assert found.back_s is not None, found
