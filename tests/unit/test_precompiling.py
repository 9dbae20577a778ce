"""Kernels compiled ahead: the list, its spelling, and the order in which processes get them."""

import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from comotion import precompiling
from comotion.precompiling import (
    Task,
    compile_ahead,
    entries,
    kinds_of_scene,
    read_types,
    spelled,
)

TESTS = Path(__file__).parents[1]
# What a first call needs, less what was listed and what is compiled within others.
LEFT = """
import sys
import numpy as np, comotion
from comotion import precompiling
sys.path.append(sys.argv[1])
from comotion_tools.kernel_list import kernels
rng = np.random.default_rng(0)
times = np.arange(60) / 30
box, floor = rng.uniform(-.2, .2, (15, 3)), rng.uniform(-1, 1, (15, 3))
turned = np.array([[[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]] for t in times])
moved = np.concatenate([box @ turned, np.repeat(floor[None], 60, 0)], axis=1)
precompiling.compile_ahead = lambda kinds: ()
comotion.group(moved + rng.normal(0, .001, moved.shape), times)
listed = {(kernel, types) for kernel, types, kinds in precompiling.entries() if "comotion m3" in kinds}
for name, one in kernels().items():
    module, _, function = name.rpartition(".")
    for signature in one.signatures:
        text = precompiling.spelled(tuple(signature))
        if text and (f"{module}:{function}", text) not in listed:
            print(name, text)
"""


def test_every_listed_kernel_is_there_and_its_types_can_be_read():
    assert len(entries()) > 50
    for kernel, text, kinds in entries():
        assert isinstance(Task(kernel, text).dispatcher, Dispatcher)
        assert spelled(read_types(text)) == text
        assert kinds


def test_a_first_group_needs_little_that_is_not_listed():
    done = subprocess.run(
        [sys.executable, "-c", LEFT, str(TESTS)], capture_output=True, text=True, check=True
    )
    # `make schemas` lists anew what kernels that have changed need.
    assert len(done.stdout.splitlines()) < 6, done.stdout


@pytest.mark.parametrize("python", ["/bin/false", "/missing"])
def test_where_processes_die_or_do_not_start_nothing_hangs(monkeypatch, tmp_path, python):
    monkeypatch.setattr(precompiling, "_is_kept", lambda task: False)
    monkeypatch.setattr(precompiling, "_mark", lambda tasks, kinds: tmp_path / "mark")
    monkeypatch.setattr(sys, "executable", python)
    kinds = kinds_of_scene("comotion", "m", 3, 1)
    done = list(compile_ahead(kinds))
    assert done[0][0] == 0
    assert not (tmp_path / "mark").exists()


def test_a_list_of_other_sources_is_no_error(monkeypatch):
    stale = [
        ("comotion.gone:kernel", '["int64"]', ["comotion m3"]),
        ("comotion.trajectories.kernels:gone", '["int64"]', ["comotion m3"]),
        ("comotion.trajectories.kernels:append", '[["comotion.gone:Arrays", "int64"]]', ["comotion m3"]),
    ]
    monkeypatch.setattr(precompiling, "entries", lambda: stale)
    assert list(compile_ahead(["comotion m3"])) == []


def test_what_is_on_the_disk_is_not_compiled_again(monkeypatch, tmp_path):
    monkeypatch.setattr(precompiling, "_is_kept", lambda task: True)
    monkeypatch.setattr(precompiling, "_mark", lambda tasks, kinds: tmp_path / "mark")
    assert list(compile_ahead(kinds_of_scene("comotion", "px", 2, 1))) == []
    assert (tmp_path / "mark").exists()
