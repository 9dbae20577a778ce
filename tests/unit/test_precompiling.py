"""Kernels compiled ahead: the list, its spelling, and the processes that compile them."""

import subprocess
import sys

import pytest
from numba.core.dispatcher import Dispatcher

from comotion import precompiling
from comotion.precompiling import Task, compile_ahead, entries, load, read_types, spelled

# What a first call needs, less what was listed.
LEFT = """
import numpy as np, comotion
from comotion import precompiling
rng = np.random.default_rng(0)
times = np.arange(60) / 30
box, floor = rng.uniform(-.2, .2, (15, 3)), rng.uniform(-1, 1, (15, 3))
turned = np.array([[[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]] for t in times])
moved = np.concatenate([box @ turned, np.repeat(floor[None], 60, 0)], axis=1)
precompiling.compile_ahead = lambda kinds: ()
comotion.group(moved + rng.normal(0, .001, moved.shape), times)
keys = {"comotion m3", "comotion m3 within"}
listed = {(kernel, types) for kernel, types, kinds in precompiling.entries() if keys & {*kinds}}
for name, one in precompiling.kernels().items():
    for signature in one.signatures:
        text = precompiling.spelled(tuple(signature))
        if text and (name, text) not in listed:
            print(name, text)
"""


def test_every_listed_kernel_is_there_and_its_types_can_be_read():
    assert len(entries()) > 50
    for kernel, text, kinds in entries():
        assert isinstance(Task(kernel, text).dispatcher, Dispatcher)
        assert spelled(read_types(text)) == text
        assert kinds


def test_a_first_group_needs_little_that_is_not_listed():
    done = subprocess.run([sys.executable, "-c", LEFT], capture_output=True, text=True, check=True)
    # `make schemas` lists anew what kernels that have changed need.
    assert len(done.stdout.splitlines()) < 6, done.stdout


@pytest.fixture
def two_tasks(monkeypatch, tmp_path):
    """A list of two kernels, and an empty folder for what is compiled."""
    chosen = [(kernel, text, ["few"]) for kernel, text, _ in entries() if kernel.endswith(":append")][:1]
    chosen += [(kernel, text, ["few"]) for kernel, text, _ in entries() if kernel.endswith(":compact")][:1]
    monkeypatch.setattr(precompiling, "entries", lambda: chosen)
    monkeypatch.setattr(precompiling, "folder", lambda: tmp_path)
    return chosen


@pytest.mark.parametrize("python", ["/bin/false", "/missing"])
def test_where_processes_die_or_do_not_start_this_one_compiles(monkeypatch, two_tasks, python):
    monkeypatch.setattr(precompiling, "_WORTH_PROCESSES", 1)
    monkeypatch.setattr(sys, "executable", python)
    assert list(compile_ahead(["few"])) == [(0, 2), (1, 2), (2, 2)]


def test_processes_compile_what_is_missing_once(monkeypatch, two_tasks, tmp_path):
    monkeypatch.setattr(precompiling, "_WORTH_PROCESSES", 1)
    monkeypatch.setattr(Task, "compile", lambda task: pytest.fail("this process compiles"))
    assert not load(["few"])
    assert list(compile_ahead(["few"])) == [(0, 2), (1, 2), (2, 2)]
    assert list(compile_ahead(["few"])) == []
    monkeypatch.setattr(Task, "compile", lambda task: None)
    assert load(["few"])
    noted = (tmp_path / "ahead.jsonl").read_text()
    for damage in (noted[:-9], "7", noted.replace("comotion.", "x.")):
        (tmp_path / "ahead.jsonl").write_text(damage)
        assert not load(["few"])


def test_a_list_of_other_sources_is_no_error(monkeypatch):
    stale = [
        ("comotion.gone:kernel", '["int64"]', ["comotion m3"]),
        ("comotion.trajectories.kernels:gone", '["int64"]', ["comotion m3"]),
        ("comotion.trajectories.kernels:append", '[["comotion.gone:Arrays", "int64"]]', ["comotion m3"]),
    ]
    monkeypatch.setattr(precompiling, "entries", lambda: stale)
    assert list(compile_ahead(["comotion m3"])) == []
