"""Services compile before they are ready, and give the same updates wherever their kernels come from."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def run(method, threads, **env):
    """What a process that meets everything prints: digest, kernels loaded, and those that were late."""
    command = [sys.executable, "-m", "tests.reference.first_tick", method]
    env = os.environ | {"NUMBA_NUM_THREADS": str(threads)} | env
    done = subprocess.run(command, check=True, cwd=ROOT, env=env, stdout=subprocess.PIPE, text=True)
    digest, loaded, *late = done.stdout.splitlines()
    return digest, int(loaded), late


@pytest.mark.parametrize("method", ["comotion", "thesis"])
def test_after_ready_nothing_is_compiled_or_loaded_and_kernels_give_the_same_wherever_they_come_from(method):
    """Signatures are counted, so it does not matter what is on the disk; CI starts from an empty folder."""
    digest, loaded, late = run(method, 1)
    assert late == []
    assert loaded > 5
    # The process itself compiles what takes the shortest, in the scenes that compile it elsewhere.
    alone = {"NUMBA_CACHE_DIR": "/dev/null"} if method == "thesis" else {}
    again, loaded, late = run(method, 2, **alone)
    assert again == digest
    assert (loaded == 0) == bool(alone)
    assert [line for line in late if not line.startswith("compiled here: ")] == []
