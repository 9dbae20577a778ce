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
def test_after_ready_nothing_is_compiled_or_loaded_and_kernels_give_the_same_wherever_they_come_from(
    method, tmp_path
):
    """Signatures are counted, so it does not matter what is on the disk; CI starts from an empty folder."""
    digest, loaded, late = run(method, 1)
    assert late == []
    assert loaded > 5
    # What takes the shortest is compiled anew.
    fresh = {"NUMBA_CACHE_DIR": str(tmp_path)} if method == "thesis" else {}
    assert run(method, 2, **fresh)[0] == digest
