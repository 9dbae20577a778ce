"""Services compile before they are ready, and give the same updates wherever their kernels come from."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from ...reference import every_kernel
from ...reference.every_kernel import SCENES

EVERY_KERNEL = Path(str(every_kernel.__file__))


def updates(
    threads: int, scenes: Sequence[str] = tuple(SCENES), folder: Path | None = None
) -> tuple[dict[str, str], int]:
    """Digests of the updates of scenes in a process of its own, and how many kernels it loaded."""
    env = {**os.environ, "NUMBA_NUM_THREADS": str(threads)}
    if folder:
        env["NUMBA_CACHE_DIR"] = str(folder)
    command = [sys.executable, str(EVERY_KERNEL), *scenes]
    answer = subprocess.run(command, check=True, env=env, stdout=subprocess.PIPE, text=True).stdout
    *digests, loaded = answer.split()
    return dict(zip(scenes, digests, strict=True)), int(loaded)


@pytest.mark.timeout(900)  # compiles
def test_processes_that_compile_and_that_load_give_the_same_updates_with_any_number_of_threads(
    digests_before, tmp_path
):
    before, compiled_before = digests_before
    before = before or updates(2)[0]
    # Where set-up has compiled everything, what takes the shortest is compiled again.
    anew = [] if compiled_before else ["thesis"]
    found, loaded = updates(1, [scene for scene in SCENES if scene not in anew])
    assert loaded > 20
    if anew:
        found |= updates(1, anew, tmp_path)[0]
    assert found == before


@pytest.mark.parametrize("method", ["comotion", "thesis"])
@pytest.mark.timeout(900)  # compiles what has changed
def test_after_ready_nothing_is_compiled_or_loaded_whatever_comes_first(method):
    """Signatures are counted, so it does not matter what is on the disk; CI starts from an empty folder."""
    script = EVERY_KERNEL.with_name("first_tick.py")
    done = subprocess.run(
        [sys.executable, str(script), method], check=True, stdout=subprocess.PIPE, text=True
    )
    assert done.stdout == ""
