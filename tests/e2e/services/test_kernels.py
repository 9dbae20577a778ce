"""Services compile before they are ready, and give the same updates wherever their kernels come from."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def printed(module, *arguments, **env):
    """What a process of a module beside the references prints."""
    command = [sys.executable, "-m", f"tests.reference.{module}", *arguments]
    done = subprocess.run(
        command, check=True, cwd=ROOT, env=os.environ | env, stdout=subprocess.PIPE, text=True
    )
    return done.stdout


def updates(threads, *scenes, **env):
    """Digests of the updates of scenes in a process of its own, and how many kernels it loaded."""
    *digests, loaded = printed("every_kernel", *scenes, NUMBA_NUM_THREADS=str(threads), **env).split()
    return dict(zip(scenes, digests, strict=True)), int(loaded)


def test_processes_that_compile_and_that_load_give_the_same_updates_with_any_number_of_threads(tmp_path):
    expected, loaded = updates(1, "thesis", "metres", "pixels")
    assert loaded > 20
    assert updates(2, "metres", "pixels")[0].items() <= expected.items()
    # What takes the shortest is compiled anew.
    assert updates(2, "thesis", NUMBA_CACHE_DIR=str(tmp_path))[0].items() <= expected.items()


@pytest.mark.parametrize("method", ["comotion", "thesis"])
def test_after_ready_nothing_is_compiled_or_loaded_whatever_comes_first(method):
    """Signatures are counted, so it does not matter what is on the disk; CI starts from an empty folder."""
    assert printed("first_tick", method) == ""
