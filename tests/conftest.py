"""How the suite is spread over cores, and the kernels compiled before."""

import gc
import os
import subprocess
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# The same examples on every run, so that a change is what makes a test fail; others are drawn with
# pytest --hypothesis-profile=random. A loaded machine fails no example for its time.
settings.register_profile("repeated", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile("repeated")

# Tests of processes; those of services take about half of the time.
_E2E = Path(__file__).parent / "e2e"
_SERVICES = "tests/e2e/services/"
_EVERY_KERNEL = Path(__file__).parent / "reference" / "every_kernel.py"
# Two processes compile at a time; the pixels come first, for the other one needs them last.
_TOGETHER = (("pixels", "thesis"), ("metres",))
# Of some 200 kernels; one that the other process had compiled a moment before may be loaded.
_FEW_LOADED = 30
_DIGESTS = pytest.StashKey[tuple[dict[str, str], bool]]()
_TO_WORKERS = "comotion_digests"
THREADS = 2
"""Threads of the processes that run every kernel before the tests."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import without looking for garbage: what is imported stays, and a third of the time went there."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let tests of real processes take long on a loaded machine: each of their waits has its own deadline."""
    for item in items:
        if item.path.is_relative_to(_E2E):
            item.add_marker(pytest.mark.timeout(600))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep a module on one worker, which starts what its tests share once.

    Tests of real processes run one after another in each of two groups: more at once starve each other.
    Groups of xdist itself are marks, which it loses with pytest 9.2.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByModule(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            if module.startswith(_SERVICES):
                return "services"
            return "other processes" if module.startswith("tests/e2e/") else module

    return ByModule(config, log)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Compile once for all workers: at the same time each would compile every kernel."""
    _compile(config)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile before any deadline of a process under test runs."""
    runs = not session.config.option.collectonly
    if runs and any("start" in getattr(item, "fixturenames", ()) for item in session.items):
        _compile(session.config)


def _compile(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        return
    config.get_terminal_writer().line("compiling what has changed: up to two minutes")
    command = [sys.executable, str(_EVERY_KERNEL)]
    env = {**os.environ, "NUMBA_NUM_THREADS": str(THREADS)}
    running = [
        subprocess.Popen([*command, *scenes, "--warm-up"], stdout=subprocess.PIPE, text=True, env=env)
        for scenes in _TOGETHER
    ]
    found: dict[str, str] = {}
    compiled = True
    for scenes, process in zip(_TOGETHER, running, strict=True):
        *digests, loaded = process.communicate()[0].split() or ["failed"]
        found |= dict(zip(scenes, digests, strict=False))
        compiled &= loaded.isdecimal() and int(loaded) <= _FEW_LOADED
    config.stash[_DIGESTS] = found, compiled


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Services under test keep their state in a folder of the test run, not in the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput[_TO_WORKERS] = node.config.stash[_DIGESTS]


@pytest.fixture(scope="session")
def digests_before(pytestconfig: pytest.Config) -> tuple[dict[str, str], bool]:
    """Digests by scene of the processes before the tests, and whether these compiled; empty if none ran."""
    given = getattr(pytestconfig, "workerinput", {}).get(_TO_WORKERS)
    return given or pytestconfig.stash.get(_DIGESTS, ({}, False))
